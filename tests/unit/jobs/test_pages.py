from sqlalchemy import Engine

from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.job_list import JobLists
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import add, attacks, start


def test_pages_show_each_job_once_while_others_are_added(record: Record, engine: Engine, clock: Clock) -> None:
    first = []
    for n in range(7):
        first.append(add(record).id)
        clock.advance(n % 2)  # some at the same moment
    seen: list[str] = []
    lists = JobLists(Database(engine))
    page = lists.page((), 2)
    while page.jobs:
        seen += [job.id for job in page.jobs]
        page = lists.page((), 2, after=page.last)
        clock.advance(1)
        add(record)
    assert sorted(seen) == sorted(first)


def test_pages_are_newest_first_and_by_state(record: Record, clock: Clock) -> None:
    jobs = []
    for _ in range(3):
        jobs.append(add(record))
        clock.advance(1)
    start(record, jobs[1])
    assert [job.id for job in attacks(record)] == [job.id for job in reversed(jobs)]
    assert [job.id for job in attacks(record, "state:running")] == [jobs[1].id]
