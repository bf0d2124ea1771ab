"""Two machines share a database and a store, and have data folders of their own. One dies in the middle of a job."""

import threading
from pathlib import Path
from typing import Any

import pytest

from scene_attack.blobs import blobs
from scene_attack.runs.execute import Progress
from scene_attack_service.jobs import files
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.files import ArtifactStore
from scene_attack_service.jobs.models import Job, State
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from scene_attack_worker.job_process import Jobs, Reporter
from tests.unit.jobs import small
from tests.unit.jobs.records import add, row, start

pytestmark = pytest.mark.slow

ATTACK = {"renderer": "image", "base_renderer": "pyrender", "steps": 6, "learning_rate": {"image": 1e-6}}
SPEC = small.spec(ATTACK, goal={"reach": "tench"})
"""An attack that takes all its steps."""


class Died(BaseException):
    """The end of a process, which no code of the job sees."""


def end_of(record: Record, store: ArtifactStore, job: Job) -> tuple[Any, dict[str, str]]:
    """The result of a job without its times, and its files that have none, by name and hash."""
    found = row(record, job)
    assert found["state"] is State.SUCCEEDED, found["failure_detail"]
    result = found["result"]
    for timed in (result["cost"], *result["trace"]):
        timed.pop("seconds")
    files = {one.name: one.sha256 for one in record.jobs.artifacts(job.id) if not one.name.endswith(".json")}
    for sha256 in files.values():
        store.open(sha256).close()
    return result, files


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_another_machine_goes_on_from_the_checkpoint_of_a_dead_one(
    request: pytest.FixtureRequest, tmp_path: Path, s3_url: str, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    url = f"sqlite:///{tmp_path / 'shared.sqlite'}"
    if kind == "postgresql":
        url = request.getfixturevalue("postgresql_url")
    first, second = (
        Settings(data=tmp_path / name, database_url=url, artifact_url=s3_url) for name in ("first", "second")
    )
    engine = connect(first)
    migrate(engine, first)
    record, store, copies = Record(engine), ArtifactStore(s3_url), blobs(s3_url, "checkpoints")
    # so that the test can close it
    monkeypatch.setattr("scene_attack_worker.job_process.connect_database", lambda _: engine)
    monkeypatch.setattr("scene_attack.attacks.run.CHECKPOINT_SECONDS", -1.0)  # after every step
    monkeypatch.setattr(files, "COPY_SECONDS", 0.005)

    undisturbed = add(record, SPEC)
    Jobs(first).run(start(record, undisturbed))
    expected = end_of(record, store, undisturbed)
    assert len(expected[0]["trace"]) == 7

    seen: list[int] = []
    go_on = Reporter.progress

    def watched(reporter: Reporter, progress: Progress) -> None:
        go_on(reporter, progress)
        if progress.row is None:
            return
        seen.append(progress.step)
        if len(seen) == 4:
            for _ in range(2000):
                if copies.exists(job.id):
                    raise Died
                threading.Event().wait(0.005)

    monkeypatch.setattr(Reporter, "progress", watched)
    job = add(record, SPEC)
    attempt = start(record, job)
    with pytest.raises(Died):
        Jobs(first).run(attempt)
    record.leases.lose(attempt)
    Jobs(second).run(start(record, job))
    assert seen[:4] == [0, 1, 2, 3]
    assert 0 < seen[4] <= 3, "the other machine began again"
    assert seen[-1] == 6
    assert end_of(record, store, job) == expected
    assert copies.names() == []
    engine.dispose()
