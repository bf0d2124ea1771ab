"""What a job keeps that ends before its time, and the job that goes on from there."""

import json
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from safetensors.torch import load

from scene_attack.analysis.images import pixels
from scene_attack.attacks import run
from scene_attack.runs.execute import Progress
from scene_attack.runs.prepare import prepare
from scene_attack.runs.result import BEST_SO_FAR, CHECKPOINT
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.files import ArtifactStore
from scene_attack_service.jobs.models import Artifact, Job
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from scene_attack_worker import job_process
from scene_attack_worker.job_process import Jobs
from tests.unit.jobs import small
from tests.unit.jobs.records import add, row, start

pytestmark = pytest.mark.slow

ATTACK = {"renderer": "image", "base_renderer": "pyrender", "steps": 6, "learning_rate": {"image": 1e-6}}
SPEC = small.spec(attack=ATTACK, goal={"reach": "tench"})
"""It does not reach its goal, so that it takes all its steps."""
FILES = [BEST_SO_FAR, CHECKPOINT, "attacked.png", "original.png", "perturbation.png", "perturbation.safetensors"]


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Record:
    """A record; checkpoints are written and the record is asked at every step."""
    monkeypatch.setattr(run, "CHECKPOINT_SECONDS", -1.0)
    monkeypatch.setattr(job_process, "REPORT_SECONDS", 0.0)
    monkeypatch.setattr(job_process, "POLL_SECONDS", 0.0)
    settings = Settings(data=tmp_path)
    engine = connect(settings)
    migrate(engine, settings)
    return Record(engine)


def cancel_at(step: int, record: Record, job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cancels the job when it reports this step."""
    report = job_process.Reporter.progress

    def progress(self: job_process.Reporter, progress: Progress) -> None:
        report(self, progress)
        if progress.row is not None and progress.row.step == step:
            record.jobs.request_cancel(job.id)

    monkeypatch.setattr(job_process.Reporter, "progress", progress)


def files(tmp_path: Path, record: Record, job: Job) -> dict[str, bytes]:
    store = ArtifactStore(Settings(data=tmp_path).files)
    found = {}
    for artifact in record.jobs.artifacts(job.id):
        with store.open(artifact.sha256) as file:
            found[artifact.name] = file.read()
    return found


def without_times(result: dict[str, Any]) -> dict[str, Any]:
    trace = [{name: value for name, value in one.items() if name != "seconds"} for one in result["trace"]]
    return result | {"trace": trace, "cost": result["cost"] | {"seconds": 0.0}}


def test_a_cancelled_job_keeps_its_best_and_another_ends_as_it_would_have(
    tmp_path: Path, record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs = Jobs(Settings(data=tmp_path))
    whole = add(record, SPEC)
    jobs.run(start(record, whole))
    expected = row(record, whole)["result"]

    job = add(record, SPEC)
    with monkeypatch.context() as patched:
        cancel_at(3, record, job, patched)
        jobs.run(start(record, job))
    ended = row(record, job)
    assert ended["state"] == "cancelled"
    assert ended["result"] is None
    assert ended["artifacts"] == sorted(FILES)
    kept = files(tmp_path, record, job)
    best = json.loads(kept[BEST_SO_FAR])
    assert not best["verified"]
    rows = expected["trace"][: best["steps"] + 1]
    assert best["step"] == min(reversed(rows), key=lambda one: one["advantage"])["step"]
    prepared = prepare(SPEC, small.LIBRARY)
    image = prepared.verifier.image(load(kept["perturbation.safetensors"]))
    assert torch.equal(pixels(Image.open(BytesIO(kept["attacked.png"]))), image)
    assert best["attacked"]["label"] == prepared.target.labels[int(prepared.verifier.logits(image).argmax())]

    [given] = [one for one in record.jobs.artifacts(job.id) if one.name == CHECKPOINT]
    later, _ = record.jobs.create(SPEC, 1000, None, lambda _: {}, file=given)
    assert later is not None
    jobs.run(start(record, later))
    found = row(record, later)
    assert without_times(found["result"]) == without_times(expected)
    steps = [one["step"] for _, kind, data in found["events"] if kind == "progress" for one in data["rows"]]
    assert steps[0] >= 3  # nothing is repeated but the step that the checkpoint had not seen


def test_a_job_that_takes_too_long_keeps_its_best_too(
    tmp_path: Path, record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock of its time leaps when it reports its third step."""
    report = job_process.Reporter.progress

    def progress(self: job_process.Reporter, progress: Progress) -> None:
        report(self, progress)
        if progress.row is not None and progress.row.step == 3:
            self._ends_at = 0.0

    monkeypatch.setattr(job_process.Reporter, "progress", progress)
    job = add(record, SPEC)
    Jobs(Settings(data=tmp_path)).run(start(record, job))
    ended = row(record, job)
    assert (ended["state"], ended["failure_kind"]) == ("failed", "timeout")
    assert ended["artifacts"] == sorted(FILES)


def test_a_checkpoint_that_is_gone_lets_the_job_begin_again(tmp_path: Path, record: Record) -> None:
    jobs = Jobs(Settings(data=tmp_path))
    job = add(record, SPEC)
    gone = Artifact(job_id=job.id, name=CHECKPOINT, sha256="ab" * 32, media_type="application/octet-stream", size=3)
    later, _ = record.jobs.create(SPEC, 1000, None, lambda _: {}, file=gone)
    assert later is not None
    jobs.run(start(record, later))
    assert row(record, later)["state"] == "succeeded"
