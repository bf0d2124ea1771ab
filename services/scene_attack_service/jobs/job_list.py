"""Lists of jobs, filtered and sorted, and what people say about single jobs: a title, tags and a note.

A list is asked for in a small language: `scene:piano renderer:torch verified p<5e-3 -tag:old`. A query is a list of
terms with spaces between them; a job is listed if it meets all of them.

What lists show of a request and of its outcome is in columns of the job. Which jobs a page has is found in one index
that has all that lists filter and sort by (`models.LISTED_BY`). Only the rows of that page are read, and of them
neither requests nor results.
"""

import math
import operator
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any, Literal, get_args

from sqlalchemy import ColumnElement, Float, Row, Select, and_, case, func, literal, or_, select, tuple_, update
from sqlalchemy import delete as deletion
from sqlalchemy.orm import InstrumentedAttribute

from scene_attack.analysis.verdict import Verdict
from scene_attack.errors import InvalidRequest
from scene_attack.text import character, there_are, unfit
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.models import Job, JobKind, JobTag, State, UtcTime

LONGEST_QUERY = 4000
"""Characters of the longest query. Each may take 12 bytes of an address, of which the head of a request has 64 kB."""
MOST_TERMS = 50
MOST_VALUES = 250
"""Terms of a query, and values of all of them. Each is a condition of its own: SQLite takes no more than a thousand,
and thousands take seconds before any job has been looked at.
"""
WORDS = ("name", "scene", "target", "asked")
"""Fields whose value is looked for anywhere in the text, in upper or lower case."""
EXACT = ("state", "kind", "renderer", "method", "outcome", "tag", "campaign", "owner")
"""Fields whose value is the whole text."""
NUMBERS = ("p", "queries", "seconds")
TIMES = ("created", "ended")
FLAGS = ("verified", "noted")
"""Fields without a value: the adversary was verified (a success), and there is a note."""
FIELDS = (*WORDS, *EXACT, "id", *NUMBERS, *TIMES)
EXAMPLE = "scene:piano renderer:torch verified p<5e-3"

_CHOICES: dict[str, tuple[str, ...]] = {
    "state": tuple(state.value for state in State),
    "kind": (JobKind.ATTACK.value, JobKind.RERENDERING.value),
    "outcome": get_args(Verdict),
}
Comparison = Literal["=", "<", "<=", ">", ">="]
_TERM = re.compile(r"""(?P<minus>-?)(?:(?P<field>[A-Za-z_]+)(?P<sign><=|>=|[:=<>]))?(?P<value>(?:"[^"]*"|[^\s"])*)""")
_COMMA = re.compile(r',(?=(?:[^"]*"[^"]*")*[^"]*$)')
"""A comma that is not between quotation marks."""


@dataclass(frozen=True)
class Term:
    """A condition. `field` is one of `FIELDS` or `FLAGS`, or "" for words that may be in any text that a list shows."""

    field: str
    sign: Comparison
    values: tuple[str | float | datetime, ...]
    """The values of which one is met: texts, a number, or a time; none for a flag."""
    wanted: bool = True
    """False for a term that begins with "-": jobs that meet it are left out."""


def parse_query(text: str) -> tuple[Term, ...]:
    """The terms of a query. Raises InvalidRequest("q"), which says where the query cannot be read and what is right."""
    if len(text) > LONGEST_QUERY:
        raise InvalidRequest("q", f"a query has at most {LONGEST_QUERY:,} characters, and this one {len(text):,}")
    if match := unfit(text.replace("\n", " ").replace("\t", " ")):
        raise _unread(match.start(), f"this is the character {character(match)}, which no name, title or tag has")
    terms, at = [], 0
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        term = _TERM.match(text, at)
        assert term is not None  # every part of the pattern may be empty
        if term.end() < len(text) and not text[term.end()].isspace():
            raise _unread(text.index('"', term.end()), "this quotation mark has no second one")
        terms.append(_term(term))
        if len(terms) > MOST_TERMS:
            raise _unread(at, f"a query has at most {MOST_TERMS} conditions, and this is one more")
        if sum(len(term.values) for term in terms) > MOST_VALUES:
            raise _unread(at, f"a query has at most {MOST_VALUES} values, and these are more")
        at = term.end()
    return tuple(terms)


def _term(match: re.Match[str]) -> Term:
    wanted, field, sign, value, at = not match["minus"], match["field"], match["sign"], match["value"], match.start()
    if field is None:
        if value in FLAGS:
            return Term(value, "=", (), wanted)
        text = _unquoted(value)
        if not text:
            raise _unread(at, "after a minus there has to be a condition, such as -tag:old")
        return Term("", "=", (text,), wanted)
    if field not in FIELDS:
        if field in FLAGS:
            raise _unread(at, f"{field} stands alone: {field}, or -{field}")
        raise _unread(match.start("field"), f"there is no field {field!r}; {there_are(field, FIELDS)}")
    at = match.start("value")
    if not value:
        raise _unread(at, f"{field}{sign} needs a value, as in {EXAMPLE}")
    if field in NUMBERS:
        return Term(field, _comparison(sign), (_number(value, at),), wanted)
    if field in TIMES:
        return Term(field, _comparison(sign), (_time(value, at),), wanted)
    if sign not in (":", "="):
        raise _unread(match.start("sign"), f"{field} is a text: write {field}:{value}")
    values = tuple(_unquoted(part) for part in _COMMA.split(value))
    if not all(values):
        raise _unread(at, f"{field} needs a value before and after each comma")
    for choice in values:
        if field in _CHOICES and choice not in _CHOICES[field]:
            raise _unread(at, f"there is no {field} {choice!r}; {there_are(choice, _CHOICES[field])}")
    return Term(field, "=", values, wanted)


def _comparison(sign: str) -> Comparison:
    return "=" if sign == ":" else sign  # type: ignore[return-value]


def _number(value: str, at: int) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise _unread(at, f"{value!r} is no number; write 5e-3 or 0.005")
    return number


def _time(value: str, at: int) -> datetime:
    try:
        time = datetime.fromisoformat(_unquoted(value))
        return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise _unread(at, f"{value!r} is no time; write 2026-11-23 or 2026-11-23T14:30, in UTC") from error


def _unquoted(value: str) -> str:
    return value.replace('"', "")


def _unread(at: int, why: str) -> InvalidRequest:
    return InvalidRequest("q", f"at character {at + 1}: {why}")


_UNLISTED = [
    "spec",
    "result",
    "note",
    "needs",
    "digest",
    "phase_at",
    "lease_owner",
    "lease_until",
]
LISTED = tuple(column for column in Job.__table__.columns if column.name not in _UNLISTED)
"""The columns of a job that lists read."""
_NAMES = tuple(column.name for column in LISTED)


class ListedJob(SimpleNamespace):
    """A job in a list: its attributes are the columns `LISTED`."""


def listed_jobs(rows: Iterable[Row[Any]]) -> Iterator[ListedJob]:
    """The jobs of rows with the columns `LISTED`, whose attributes are read in an eighth of the time of the rows'."""
    return (ListedJob(**dict(zip(_NAMES, row, strict=True))) for row in rows)


SORTS: dict[str, Any] = {
    "created": Job.created_at,
    "ended": Job.ended_at,
    "name": func.coalesce(Job.title, Job.scene),
    "scene": Job.scene,
    "renderer": Job.renderer,
    "method": Job.method,
    "target": Job.target,
    "state": Job.state,
    "outcome": Job.verdict,
    "verified": Job.verified,
    "p": Job.p,
    "queries": Job.queries,
    "seconds": Job.seconds,
}
"""Keys by which a list may be sorted, each with its column. A job without a value comes last, in both directions."""
_COLUMNS: dict[str, InstrumentedAttribute[Any]] = {
    **SORTS,
    "campaign": Job.campaign_id,
    "kind": Job.kind,
    "asked": Job.asked,
    "owner": Job.owner,
}
"""The columns of the other fields of a query; "name", "tag" and "verified" are read otherwise."""
_COMPARE: dict[str, Callable[[Any, Any], ColumnElement[bool]]] = {
    "=": operator.eq,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_ANYWHERE = (Job.title, Job.scene, Job.renderer, Job.method, Job.target)
"""The texts in which words without a field are looked for."""


@dataclass(frozen=True)
class Place:
    """A job's place in a sorted list: its value there, None if it has none, and when it was submitted."""

    value: Any
    created_at: datetime
    job_id: str


@dataclass(frozen=True)
class ListPage:
    """A part of a list."""

    jobs: list[ListedJob]
    first: Place | None
    """Place of the first job on the page; None for an empty page."""
    last: Place | None
    """Place of the last job on the page; None for an empty page."""
    more_before: bool
    """Whether the list has jobs before the page."""
    more_after: bool
    """Whether the list has jobs after the page."""


@dataclass(frozen=True)
class ListTotals:
    """Sums over a whole list. Those of an outcome are over the jobs that have one."""

    jobs: int
    states: dict[State, int]
    verified: int
    decided: int
    """Jobs that have an outcome, of which `verified` are successes."""
    queries: int
    seconds: float


class JobLists:
    """Reads lists of jobs, and writes what people say about them. Terms of the field `kind` show re-renderings, too."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def page(
        self,
        terms: Sequence[Term],
        limit: int,
        *,
        sort: str = "-created",
        after: Place | None = None,
        before: Place | None = None,
        owner: str | None = None,
    ) -> ListPage:
        """At most `limit` jobs that meet the terms: those after or before a place, or the first ones.

        `sort` is one of `SORTS`, with "-" before it for the greatest first. Jobs with equal values are in the order of
        their submission, in the same direction. If `owner` is given, only the owner's.
        """
        column, descending = SORTS[sort.removeprefix("-")], sort.startswith("-")
        by_age = column is Job.created_at  # whose index leads to the rows; any other order is made of `LISTED_BY` alone
        columns = LISTED if by_age else (Job.id, column.label("value"), Job.created_at)
        query = self._matching(select(*columns), terms, owner)
        place = after or before
        backwards = after is None and before is not None
        if place is not None:
            query = query.where(_beyond(column, place, descending=descending, backwards=backwards))
        query = query.order_by(*_order(column, descending=descending, backwards=backwards)).limit(limit + 1)
        with self._database.read() as session:
            rows = session.execute(query).all()
            more, rows = len(rows) > limit, list(rows[:limit])
            if backwards:
                rows.reverse()
            if by_age:
                jobs = list(listed_jobs(rows))
            else:
                ids = [row.id for row in rows]
                read = listed_jobs(session.execute(select(*LISTED).where(Job.id.in_(ids))))
                by_id = {job.id: job for job in read}
                jobs = [by_id[job_id] for job_id in ids if job_id in by_id]
        places = [
            Place(row.created_at if by_age else row.value, row.created_at, row.id) for row in (*rows[:1], *rows[-1:])
        ]
        return ListPage(
            jobs=jobs,
            first=places[0] if places else None,
            last=places[-1] if places else None,
            more_before=more if backwards else after is not None,
            more_after=before is not None if backwards else more,
        )

    def totals(self, terms: Sequence[Term], owner: str | None = None) -> ListTotals:
        """Sums over all jobs that meet the terms."""
        decided, verified = func.count(Job.verdict), func.sum(case((Job.verified.is_(True), 1), else_=0))
        sums = (func.count(), verified, decided, func.sum(Job.queries), func.sum(Job.seconds))
        query = self._matching(select(Job.state, *sums), terms, owner).group_by(Job.state)
        with self._database.read() as session:
            rows = session.execute(query).all()
        return ListTotals(
            jobs=sum(row[1] for row in rows),
            states={row[0]: row[1] for row in rows},
            verified=sum(int(row[2] or 0) for row in rows),
            decided=sum(row[3] for row in rows),
            queries=sum(int(row[4] or 0) for row in rows),
            seconds=float(sum(row[5] or 0 for row in rows)),
        )

    def edit(self, job_id: str, changes: Mapping[str, Any]) -> None:
        """Writes a job's `title`, `note` and `tags`, those that are given. Does nothing if there is no such job."""
        values = dict(changes)
        if "tags" in values:
            values["tags"] = sorted(set(values["tags"]))
        with self._database.write() as session:
            session.execute(select(Job.id).where(Job.id == job_id).with_for_update())  # so that tags and job agree
            changed = update(Job).where(Job.id == job_id).values(values).returning(Job.id)
            if values and session.scalar(changed) is not None and "tags" in values:
                session.execute(deletion(JobTag).where(JobTag.job_id == job_id))
                session.add_all(JobTag(job_id=job_id, tag=tag) for tag in values["tags"])

    def retries(self, job_id: str, owner: str | None = None) -> list[str]:
        """The ids of the jobs that repeat a job, the first one first. If `owner` is given, only the owner's."""
        query = select(Job.id).where(Job.retry_of == job_id).order_by(Job.created_at, Job.id)
        with self._database.read() as session:
            return list(session.scalars(query if owner is None else query.where(Job.owner == owner)))

    def _matching(self, query: Select[*tuple[Any, ...]], terms: Collection[Term], owner: str | None) -> Any:
        kinds = [JobKind.ATTACK, *([JobKind.RERENDERING] if any(term.field == "kind" for term in terms) else [])]
        query = query.where(Job.kind.in_(kinds), *map(_condition, terms))
        if owner is not None:
            query = query.where(Job.owner == owner)
        return query


def _condition(term: Term) -> ColumnElement[bool]:
    met = _met(term)
    return met if term.wanted else ~func.coalesce(met, False)


def _met(term: Term) -> ColumnElement[bool]:
    if term.field == "verified":
        return Job.verified.is_(True)
    if term.field == "noted":
        return Job.note.is_not(None)
    if term.field == "tag":
        return Job.id.in_(select(JobTag.job_id).where(JobTag.tag.in_(term.values)))
    if term.field in ("campaign", "state", "kind", "outcome", "renderer", "method", "owner"):
        return _COLUMNS[term.field].in_(term.values)
    return or_(*(_one(term, value) for value in term.values))


def _one(term: Term, value: Any) -> ColumnElement[bool]:
    if term.field == "":
        columns = (column.icontains(value, autoescape=True) for column in _ANYWHERE)
        return or_(Job.id.startswith(value, autoescape=True), *(func.coalesce(column, False) for column in columns))
    if term.field == "id":
        return Job.id.startswith(value, autoescape=True)
    if term.field == "name":
        return or_(
            *(func.coalesce(column.icontains(value, autoescape=True), False) for column in (Job.title, Job.name))
        )
    column = _COLUMNS[term.field]
    if isinstance(value, str):
        return column.icontains(value, autoescape=True)
    if isinstance(value, float):
        value = literal(value, Float(53))  # in the type of `queries` PostgreSQL would round it, or refuse a large one
    return _COMPARE[term.sign](column, value)


def _order(column: Any, *, descending: bool, backwards: bool) -> list[Any]:
    keys = [Job.created_at, Job.id]
    down = descending != backwards
    directed = [key.desc() if down else key.asc() for key in ([] if column is Job.created_at else [column]) + keys]
    if column is Job.created_at:
        return directed
    empty = column.is_(None)
    return [empty.desc() if backwards else empty.asc(), *directed]


def _beyond(column: Any, place: Place, *, descending: bool, backwards: bool) -> ColumnElement[bool]:
    """The condition of the jobs that come after a place, in the order of `_order`."""
    down = descending != backwards
    tie = tuple_(literal(place.created_at, UtcTime()), literal(place.job_id))
    beside = tuple_(Job.created_at, Job.id) < tie if down else tuple_(Job.created_at, Job.id) > tie
    if column is Job.created_at:
        return beside
    if place.value is None:
        same = and_(column.is_(None), beside)
        return or_(same, column.is_not(None)) if backwards else same
    value = literal(place.value, column.type)
    further = or_(column < value if down else column > value, and_(column == value, beside))
    return further if backwards else or_(further, column.is_(None))
