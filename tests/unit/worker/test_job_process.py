import errno
from math import inf
from pathlib import Path

import pytest
import torch

from scene_attack.attacks.trace import TraceRow
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.runs.execute import Progress
from scene_attack.runs.spec import JobSpec, digest
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.models import State
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from scene_attack_worker.job_process import POLL_SECONDS, REPORT_SECONDS, Jobs, Reporter, classify
from tests.unit.jobs import small
from tests.unit.jobs.records import add, row, start

ROW = {
    "loss": 0.5,
    "label": "balloon",
    "confidence": 0.5,
    "advantage": 0.1,
    "objective": 0.1,
    "distance": 0.0,
    "perceptibility": 0.0,
    "truncated": 0,
    "queries": 1,
    "renders": 1,
    "seconds": 0.1,
}


class Seconds:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def record(tmp_path: Path) -> Record:
    return open_record(tmp_path)


def open_record(data: Path) -> Record:
    settings = Settings(data=data)
    engine = connect(settings)
    migrate(engine, settings)
    return Record(engine)


def progress(step: int, phase: str = "attacking", **values: float) -> Progress:
    row = TraceRow(step=step, **(ROW | values)) if phase == "attacking" else None
    return Progress.model_validate({"phase": phase, "step": step, "steps": 9, "row": row and row.model_dump()})


def test_reports_are_few_and_leave_no_step_out(record: Record) -> None:
    job = add(record)
    seconds = Seconds()
    reporter = Reporter(record, start(record, job), seconds)
    reporter.progress(progress(0, "loading"))
    for step in range(9):
        reporter.progress(progress(step))
        seconds.now += REPORT_SECONDS / 2
    reporter.progress(progress(9, "analysing"))
    told = [event.data for event in record.jobs.events(job.id, 2)]
    assert [data["phase"] for data in told] == ["loading", *["attacking"] * 5, "analysing"]
    assert [row["step"] for data in told for row in data["rows"]] == list(range(9))


def test_a_number_that_is_not_finite_ends_the_job_by_name(record: Record) -> None:
    reporter = Reporter(record, start(record, add(record)), Seconds())
    with pytest.raises(JobFailure) as caught:
        reporter.progress(progress(0, loss=inf))
    assert caught.value.kind == "non-finite"


@pytest.mark.parametrize("why", ["cancelled", "taken back"])
def test_a_job_that_must_stop_is_told_at_the_next_look(record: Record, why: str) -> None:
    job = add(record)
    seconds = Seconds()
    attempt = start(record, job)
    reporter = Reporter(record, attempt, seconds)
    assert not reporter.stop()
    if why == "cancelled":
        record.jobs.request_cancel(job.id)
    else:
        record.leases.lose(attempt)
    seconds.now += POLL_SECONDS
    assert reporter.stop()
    assert reporter.stop()


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (JobFailure("non-finite", "x"), "non-finite"),
        (InvalidRequest("scene.objects.0.mesh", "gone"), "asset-missing"),
        (MemoryError(), "out-of-memory"),
        (torch.OutOfMemoryError("x"), "out-of-memory"),
        (RuntimeError("[enforce fail at alloc_cpu.cpp:1] DefaultCPUAllocator: can't allocate memory"), "out-of-memory"),
        (RuntimeError("std::bad_alloc"), "out-of-memory"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "out-of-memory"),
        (JobFailure("out-of-memory", "target 'mine' needs more memory than is left"), "out-of-memory"),
        (ValueError("a mistake"), "internal"),
        (SystemExit(3), "internal"),
    ],
)
def test_every_end_has_a_name(error: BaseException, kind: str) -> None:
    failure = classify(error, 3 * 2**30)
    assert failure.kind == kind
    assert (kind == "out-of-memory") == ("SCENE_ATTACK_JOB_MEMORY_BYTES allows a process, 3 GiB" in failure.detail)


@pytest.mark.parametrize(("label", "state"), [("tench", State.SUCCEEDED), ("no such thing", State.REJECTED)])
def test_a_job_accepted_before_its_check_is_checked_first(tmp_path: Path, label: str, state: State) -> None:
    record, jobs = open_record(tmp_path), Jobs(Settings(data=tmp_path))
    job = add(record, small.spec(attack={"steps": 1}, goal={"reach": label}), checked=False)
    jobs.run(start(record, job))
    found = row(record, job)
    assert found["state"] is state
    if state is State.REJECTED:
        assert [error["field"] for error in found["errors"]] == ["goal.reach"]
        assert not found["checked"]
    else:
        assert found["checked"]
        assert found["spec"] == found["result"]["spec"]
        assert found["spec"]["goal"]["leave"] is None
        assert found["digest"] == digest(JobSpec.model_validate(found["spec"]))


def test_a_checked_job_whose_mesh_has_gone_failed(tmp_path: Path) -> None:
    record, jobs = open_record(tmp_path), Jobs(Settings(data=tmp_path))
    job = add(record, small.spec(scene={"objects": [{"mesh": f"sha256:{'0' * 64}"}]}))
    jobs.run(start(record, job))
    assert row(record, job)["failure_kind"] == "asset-missing"
