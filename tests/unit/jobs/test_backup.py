import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import pytest

from services.errors import InvalidRequest, JobFailure
from services.jobs.artifacts import ArtifactStore
from services.jobs.backup import back_up
from services.jobs.database import connect, migrate
from services.jobs.models import Artifact
from services.jobs.repository import Repository
from services.settings import Settings
from tests.unit.jobs.records import OUTCOME, add, start


@pytest.fixture
def data(tmp_path: Path) -> Path:
    settings = Settings(data=tmp_path / "data")
    engine = connect(settings)
    migrate(engine, settings)
    engine.dispose()
    return tmp_path / "data"


def finish(data: Path, repository: Repository, text: str) -> None:
    """Records a finished job with a file that has this text."""
    store, file = ArtifactStore(data), data / "file.txt"
    file.write_text(text)
    stored = store.put(file)
    job = add(repository)
    named = Artifact(job_id=job.id, name="file.txt", sha256=stored.sha256, media_type="text/plain", size=stored.size)
    assert repository.succeed(start(repository, job), {}, OUTCOME, [named])


def test_a_copy_made_while_jobs_end_has_every_file_it_names(data: Path, tmp_path: Path) -> None:
    repository = Repository(connect(Settings(data=data)))
    finish(data, repository, "first")
    copied = threading.Event()
    written = []

    def work() -> None:
        while not copied.is_set():
            finish(data, repository, f"while it is copied {len(written)}")
            written.append(1)

    worker = threading.Thread(target=work)
    worker.start()
    made = back_up(data, tmp_path / "copy", with_database=True)
    copied.set()
    worker.join()
    assert made.jobs is not None
    assert 1 <= made.jobs <= 1 + len(written)
    assert made.files >= made.jobs
    with closing(sqlite3.connect(tmp_path / "copy" / "jobs.sqlite")) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


def test_the_copy_is_a_data_directory(data: Path, tmp_path: Path) -> None:
    repository = Repository(connect(Settings(data=data)))
    finish(data, repository, "done")
    queued, running = add(repository), add(repository)
    start(repository, running, seconds=-1)
    (data / "assets").mkdir()
    (data / "assets" / "mesh").write_bytes(b"mesh")
    (data / "artifacts" / "half.part").write_bytes(b"half")
    back_up(data, tmp_path / "copy", with_database=True)
    restored = Settings(data=tmp_path / "copy")
    engine = connect(restored)
    migrate(engine, restored)
    there = Repository(engine)
    assert there.take_back(5) == [running.id]
    assert {waiting.job_id for waiting in there.queued()} == {queued.id, running.id}
    assert (tmp_path / "copy" / "assets" / "mesh").read_bytes() == b"mesh"
    assert not list((tmp_path / "copy").rglob("*.part"))


def test_what_cannot_be_a_backup_is_refused(data: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="is not empty"):
        back_up(data, data, with_database=True)
    with pytest.raises(InvalidRequest, match="no database"):
        back_up(tmp_path / "nothing", tmp_path / "copy", with_database=True)
    finish(data, Repository(connect(Settings(data=data))), "lost")
    [lost] = [path for path in (data / "artifacts").rglob("*") if path.is_file()]
    lost.unlink()
    with pytest.raises(JobFailure, match="1 of 1 artifacts are missing"):
        back_up(data, tmp_path / "copy", with_database=True)
