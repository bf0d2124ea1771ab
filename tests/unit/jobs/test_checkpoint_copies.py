"""Checkpoints that another machine goes on from, in a folder and in an object store alike."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from safetensors.torch import save_file

from scene_attack.blobs import Blobs, blobs
from scene_attack_service.jobs import files
from scene_attack_service.jobs.files import CheckpointCopies, WorkingFiles
from scene_attack_service.jobs.leases import Attempt
from scene_attack_service.jobs.record import Record
from tests.unit.jobs.records import add, start

pytestmark = pytest.mark.slow

JOB = "0f" * 16


@pytest.fixture(params=["file URL", "S3"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "S3":
        return str(request.getfixturevalue("s3_url"))
    return f"file://{tmp_path / 'store'}"


@pytest.fixture
def store(url: str) -> Blobs:
    return blobs(url, "checkpoints")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "COPY_SECONDS", 0.005)


def save(path: Path, step: int) -> bytes:
    """Writes a file with the step of a checkpoint, and returns its bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file({"delta": torch.full((3,), float(step))}, path, {"run": json.dumps({"step": step})})
    return path.read_bytes()


def until(look: Callable[[], bool]) -> None:
    for _ in range(2000):
        if look():
            return
        threading.Event().wait(0.005)
    raise AssertionError("waited in vain")


def read(store: Blobs) -> bytes:
    with store.open(JOB) as file:
        return file.read()


def copied(url: str, path: Path, job_id: str = JOB) -> None:
    """Copies a checkpoint as a machine of its own would."""
    with CheckpointCopies(url).kept(job_id, path):
        until(lambda: blobs(url, "checkpoints").exists(job_id))


@pytest.mark.usefixtures("quick")
def test_another_machine_goes_on_from_the_newest_copy(url: str, store: Blobs, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    with CheckpointCopies(url).kept(JOB, here):  # there is no checkpoint yet
        save(here, 1)
        until(lambda: store.exists(JOB))
        first = read(store)
        data = save(here, 2)
        until(lambda: read(store) != first)
    CheckpointCopies(url).fetch(JOB, there)
    assert there.read_bytes() == data
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == ["here", "there"]


@pytest.mark.usefixtures("quick")
def test_a_checkpoint_that_has_got_further_stays(url: str, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    save(here, 5)
    copied(url, here)
    own = save(there, 6)
    CheckpointCopies(url).fetch(JOB, there)
    assert there.read_bytes() == own
    save(there, 4)
    CheckpointCopies(url).fetch(JOB, there)
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("damage", ["torn", "changed", "another job's", "empty"])
def test_a_damaged_copy_is_ignored(url: str, store: Blobs, tmp_path: Path, damage: str) -> None:
    save(tmp_path / "here", 5)
    copied(url, tmp_path / "here")
    data = bytearray(read(store))
    if damage == "changed":
        data[-1] ^= 1
    other = "1e" * 16 if damage == "another job's" else JOB
    store.write(other, {"torn": bytes(data[:-9]), "empty": b""}.get(damage, bytes(data)))
    CheckpointCopies(url).fetch(other, tmp_path / "there")
    assert not (tmp_path / "there").exists()


def test_a_short_job_makes_no_copy(url: str, tmp_path: Path) -> None:
    save(tmp_path / "here", 1)
    with CheckpointCopies(url).kept(JOB, tmp_path / "here"):
        pass
    assert blobs(url, "checkpoints").names() == []


@pytest.mark.usefixtures("quick", "s3_server")
def test_a_store_that_does_not_answer_stops_no_attack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(files, "log", SimpleNamespace(warning=lambda event, **_: said.append(event)))
    save(tmp_path / "here", 1)
    copies = CheckpointCopies("s3://no-such-bucket/folder")
    with copies.kept(JOB, tmp_path / "here"):
        until(lambda: "checkpoint not copied" in said)
    copies.fetch(JOB, tmp_path / "there")
    copies.remove(JOB)
    assert not (tmp_path / "there").exists()


@pytest.mark.usefixtures("quick")
def test_a_copy_goes_with_its_job(record: Record, url: str, store: Blobs, tmp_path: Path) -> None:
    first, second = WorkingFiles(tmp_path / "a", url), WorkingFiles(tmp_path / "b", url)
    job, others = add(record), [add(record), add(record)]
    attempt = start(record, job)
    with first.checkpoint(attempt) as path:
        data = save(path, 3)
        until(lambda: store.exists(job.id))
    for other in others:
        copied(url, path, other.id)
    record.leases.lose(attempt)
    attempt = start(record, job)
    with second.checkpoint(attempt) as path:
        assert path.read_bytes() == data
    second.forget(record, job.id)
    assert job.id in store.names(), "the job has not ended"
    record.leases.fail(attempt, "internal", "because")
    second.forget(record, job.id)
    assert store.names() == sorted(other.id for other in others)
    record.jobs.request_cancel(others[0].id)
    second.forget_copies(record)
    assert store.names() == [others[1].id]


@pytest.mark.usefixtures("quick")
def test_a_first_attempt_does_not_ask_the_store(url: str, tmp_path: Path) -> None:
    save(tmp_path / "here", 3)
    copied(url, tmp_path / "here")
    with WorkingFiles(tmp_path / "b", url).checkpoint(Attempt(JOB, 1)) as path:
        assert not path.exists()
