from services.jobs.models import State
from services.jobs.repository import Repository
from tests.unit.jobs.conftest import Clock
from tests.unit.jobs.records import add, start


def test_pages_show_each_job_once_while_others_are_added(repository: Repository, clock: Clock) -> None:
    first = []
    for n in range(7):
        first.append(add(repository).id)
        clock.advance(n % 2)  # some at the same moment
    seen: list[str] = []
    before = None
    while jobs := repository.page(None, 2, before):
        seen += [job.id for job in jobs]
        before = (jobs[-1].created_at, jobs[-1].id)
        clock.advance(1)
        add(repository)
    assert sorted(seen) == sorted(first)


def test_pages_are_newest_first_and_by_state(repository: Repository, clock: Clock) -> None:
    jobs = []
    for _ in range(3):
        jobs.append(add(repository))
        clock.advance(1)
    start(repository, jobs[1])
    assert [job.id for job in repository.page(None, 9, None)] == [job.id for job in reversed(jobs)]
    assert [job.id for job in repository.page(State.RUNNING, 9, None)] == [jobs[1].id]
