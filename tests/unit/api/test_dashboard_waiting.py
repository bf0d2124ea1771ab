"""Jobs that wait for a worker which can run them, on the pages."""

import pytest

from services.jobs.record import Record
from services.jobs.scheduler import Demand, Needs, Waiting
from services.jobs.states import Priority
from tests.unit.api.dashboard_records import SPEC, add, start
from tests.unit.api.test_dashboard_pages import Tags, anyio_backend, get, record

__all__ = ["anyio_backend", "record"]
pytestmark = pytest.mark.anyio


async def test_a_job_that_no_worker_can_run_says_why(record: Record) -> None:
    why = "no worker that is running has the network <x>"
    job = add(record)
    other, _ = record.jobs.create(SPEC, 1000, None, lambda _: {}, demand=Demand(priority=Priority.LOW))
    assert other is not None
    record.scheduler.explain(Waiting(job.priority, Needs.read(job.needs), None), why)
    assert Tags((await get(record, "/")).text).text.count(why) == 1
    tags = Tags((await get(record, f"/jobs/{job.id}")).text)
    assert f"Waiting for a worker: {why}." in tags.text
    assert any(a.get("data-poll") for a in tags.all("div")), "no event tells of a reason that has gone"
    assert "Waiting for a worker." in Tags((await get(record, f"/jobs/{other.id}")).text).text
    start(record, job)
    tags = Tags((await get(record, f"/jobs/{job.id}")).text)
    assert why not in tags.text
    assert not any(a.get("data-poll") for a in tags.all("div"))
