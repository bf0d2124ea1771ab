"""Lists compared with the same filter and order in Python, with both databases."""

from itertools import chain, pairwise
from typing import Any

import pytest
from sqlalchemy import Engine, text

from scene_attack.runs.spec import parse
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.job_list import SORTS, JobLists, parse_query
from scene_attack_service.jobs.models import State
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import OUTCOME, add, start

pytestmark = pytest.mark.slow

VERDICTS = ("fooled", "held", "still-wrong")


@pytest.fixture
def lists(engine: Engine, clock: Clock) -> JobLists:
    return JobLists(Database(engine, clock))


@pytest.fixture
def jobs(record: Record, clock: Clock) -> list[str]:
    """Eleven jobs: every third one queued, the others ended; some with equal values, some submitted at one moment."""
    made = []
    for n in range(11):
        scene = {"objects": [{"mesh": ("primitive/sphere", "furniture/grand-piano")[n % 2]}]}
        job = add(record, parse({"scene": scene, "attack": {"renderer": ("image", "torch")[n % 2]}, "seed": n}))
        clock.advance(n % 2)
        if n % 3:
            attempt = start(record, job)
            found = {"outcome": VERDICTS[n % 3], "float_perceptibility": (n % 4) / 1000}
            found |= {"steps": n, "queries": n % 5, "seconds": n / 2}
            record.leases.succeed(attempt, {}, OUTCOME | found, [])
        made.append(job.id)
    return made


def listed(lists: JobLists, query: str = "", **about: Any) -> list[str]:
    return [job.id for job in lists.page(parse_query(query), 100, **about).jobs]


@pytest.mark.parametrize("sort", [sign + name for name in SORTS for sign in ("", "-")])
def test_pages_forwards_and_backwards_are_the_whole_list(lists: JobLists, jobs: list[str], sort: str) -> None:
    whole = listed(lists, sort=sort)
    assert sorted(whole) == sorted(jobs)
    pages, after = [], None
    while True:
        page = lists.page((), 3, sort=sort, after=after)
        pages.append([job.id for job in page.jobs])
        if not page.more_after:
            break
        after = page.last
    assert list(chain(*pages)) == whole
    assert page.more_before
    back = [pages[-1]]
    while page.more_before:
        page = lists.page((), 3, sort=sort, before=page.first)
        back.insert(0, [job.id for job in page.jobs])
    assert list(chain(*back)) == whole
    assert page.more_after


@pytest.mark.parametrize("sort", ["p", "-p", "queries", "-ended", "outcome"])
def test_a_list_is_sorted_and_jobs_without_a_value_come_last(lists: JobLists, jobs: list[str], sort: str) -> None:
    column = {"p": "p", "queries": "queries", "ended": "ended_at", "outcome": "verdict"}[sort.removeprefix("-")]
    found = [getattr(job, column) for job in lists.page((), 100, sort=sort).jobs]
    there = [value for value in found if value is not None]
    assert found == [*there, *[None] * (len(jobs) - len(there))]
    assert None in found
    pairs = [(b, a) if sort.startswith("-") else (a, b) for a, b in pairwise(there)]
    assert all(a <= b for a, b in pairs)


@pytest.mark.parametrize(
    ("query", "wanted"),
    [
        ("scene:PIANO", lambda n: n % 2 == 1),
        ("renderer:image", lambda n: n % 2 == 0),
        ("renderer:ima", lambda _: False),
        ("piano", lambda n: n % 2 == 1),
        ("name:sphere", lambda n: n % 2 == 0),
        ("state:queued", lambda n: n % 3 == 0),
        ("-state:queued", lambda n: n % 3 > 0),
        ("state:queued,succeeded", lambda _: True),
        ("outcome:held", lambda n: n % 3 == 1),
        ("verified", lambda _: False),
        ("-verified", lambda _: True),
        ("p<2e-3", lambda n: n % 3 > 0 and n % 4 < 2),
        ("-p<2e-3", lambda n: not (n % 3 > 0 and n % 4 < 2)),
        ("queries>=3 seconds<4.5", lambda n: n % 3 > 0 and n % 5 >= 3 and n / 2 < 4.5),
        ("created>2030-01-01T00:00:02", lambda n: n // 2 > 2),
        ("ended<2029-01-01", lambda _: False),
        ("100%", lambda _: False),
        ("tag:x", lambda _: False),
        ("noted", lambda _: False),
        ("campaign:none", lambda _: False),
        ("asked:cube", lambda _: False),
    ],
)
def test_filters(lists: JobLists, jobs: list[str], query: str, wanted: Any) -> None:
    expected = [job for n, job in enumerate(jobs) if wanted(n)]
    assert sorted(listed(lists, query)) == sorted(expected)
    assert lists.totals(parse_query(query)).jobs == len(expected)


def test_ids_and_owners(lists: JobLists, jobs: list[str]) -> None:
    assert listed(lists, f"id:{jobs[4][:12]},{jobs[1]}") == [jobs[4], jobs[1]]
    assert listed(lists, jobs[3][:12]) == [jobs[3]]
    assert listed(lists, owner="alice") == []
    assert lists.totals((), owner="alice").jobs == 0


def test_totals_are_sums_over_the_list(lists: JobLists, jobs: list[str]) -> None:  # noqa: ARG001 - they are there
    found = lists.totals(())
    ended = [n for n in range(11) if n % 3]
    assert found.states == {State.QUEUED: 4, State.SUCCEEDED: 7}
    assert (found.jobs, found.decided, found.verified) == (11, 7, 0)
    assert (found.queries, found.seconds) == (sum(n % 5 for n in ended), sum(ended) / 2)


def test_only_a_success_is_verified(lists: JobLists, record: Record) -> None:
    ids = []
    for verdict in VERDICTS:
        job = add(record)
        record.leases.succeed(start(record, job), {}, OUTCOME | {"outcome": verdict}, [])
        ids.append(job.id)
    assert listed(lists, "verified") == ids[:1]
    assert lists.totals(()).verified == 1


def test_what_people_say_is_kept_and_found(lists: JobLists, record: Record, jobs: list[str]) -> None:
    lists.edit(jobs[2], {"title": "Überraschung 100%", "tags": ["b", "a", "b"], "note": "look at the lamp"})
    lists.edit(jobs[5], {"tags": ["a"]})
    assert listed(lists, "tag:a") == [jobs[5], jobs[2]]
    assert listed(lists, "tag:a -tag:b") == [jobs[5]]
    assert listed(lists, "noted") == listed(lists, "name:100%") == listed(lists, "raschung") == [jobs[2]]
    lists.edit(jobs[2], {"tags": []})
    edited = record.jobs.get(jobs[2])
    assert edited is not None
    assert (edited.title, edited.tags, edited.note) == ("Überraschung 100%", [], "look at the lamp")
    assert listed(lists, "tag:b") == []
    lists.edit("unknown", {"tags": ["a"]})
    assert listed(lists, "tag:a") == [jobs[5]]


def test_the_longest_texts_fit_into_the_index(lists: JobLists, record: Record, engine: Engine) -> None:
    job = add(record)
    lists.edit(job.id, {"title": "𝒳" * 100})
    with engine.begin() as connection:
        connection.execute(
            text("UPDATE jobs SET scene = :scene"), {"scene": "".join(chr(0x10000 + n) for n in range(300))}
        )
    assert listed(lists, "𝒳") == [job.id]
