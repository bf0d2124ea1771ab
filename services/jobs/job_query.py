"""The language in which lists of jobs are asked for: `scene:piano renderer:torch verified p<5e-3 -tag:old`.

A query is a list of terms with spaces between them; a job is listed if it meets all of them. This module reads queries;
`services.jobs.lists` asks the database.
"""

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, get_args

from services.attacks.verdict import Verdict
from services.errors import InvalidRequest
from services.jobs.models import JobKind, State
from services.suggestions import there_are
from services.written_text import character, unfit

LONGEST = 4000
"""Characters of the longest query. Each may take 12 bytes of an address, of which the head of a request has 64 kB."""
MOST_TERMS = 50
MOST_VALUES = 250
"""Terms of a query, and values of all of them. Each is a condition of its own: SQLite takes no more than a thousand,
and thousands take seconds before any job has been looked at.
"""
WORDS = ("name", "scene", "target", "question")
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
    if len(text) > LONGEST:
        raise InvalidRequest("q", f"a query has at most {LONGEST:,} characters, and this one {len(text):,}")
    if found := unfit(text.replace("\n", " ").replace("\t", " ")):
        raise _unread(found.start(), f"this is the character {character(found)}, which no name, title or tag has")
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


def _term(found: re.Match[str]) -> Term:
    wanted, field, sign, value, at = not found["minus"], found["field"], found["sign"], found["value"], found.start()
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
        raise _unread(found.start("field"), f"there is no field {field!r}; {there_are(field, FIELDS)}")
    at = found.start("value")
    if not value:
        raise _unread(at, f"{field}{sign} needs a value, as in {EXAMPLE}")
    if field in NUMBERS:
        return Term(field, _comparison(sign), (_number(value, at),), wanted)
    if field in TIMES:
        return Term(field, _comparison(sign), (_time(value, at),), wanted)
    if sign not in (":", "="):
        raise _unread(found.start("sign"), f"{field} is a text: write {field}:{value}")
    values = tuple(_unquoted(one) for one in _COMMA.split(value))
    if not all(values):
        raise _unread(at, f"{field} needs a value before and after each comma")
    for one in values:
        if field in _CHOICES and one not in _CHOICES[field]:
            raise _unread(at, f"there is no {field} {one!r}; {there_are(one, _CHOICES[field])}")
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
