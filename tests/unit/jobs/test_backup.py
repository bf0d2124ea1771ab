"""Copies of a service's data, of each kind of database and store, and services that are started on the copies."""

import shutil
import sqlite3
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import make_url

from scene_attack.blobs import blobs
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack_service.jobs.backup import PARTS, back_up
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.files import ArtifactStore
from scene_attack_service.jobs.models import Artifact, State
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from tests.unit.jobs.records import OUTCOME, add, attacks, start

pytestmark = pytest.mark.slow

Restore = Callable[[Settings, Path], Settings]


@pytest.fixture(params=["folder", "S3"])
def service(request: pytest.FixtureRequest, database: Settings) -> Settings:
    """The settings of a service whose record is empty."""
    url = request.getfixturevalue("s3_url") if request.param == "S3" else None
    return database.model_copy(update={"artifact_url": url})


@pytest.fixture
def record(service: Settings) -> Iterator[Record]:
    engine = connect(service)
    yield Record(engine)
    engine.dispose()


def finish(service: Settings, record: Record, text: str) -> str:
    """Records a finished job with a file that has this text, and returns the job's id."""
    store, file = ArtifactStore(service.files), service.data_dir / "file.txt"
    file.write_text(text)
    stored = store.put(file)
    job = add(record)
    named = Artifact(job_id=job.id, name="file.txt", sha256=stored.sha256, media_type="text/plain", size=stored.size)
    assert record.leases.succeed(start(record, job), {}, OUTCOME, [named])
    return job.id


@pytest.fixture
def restore(request: pytest.FixtureRequest) -> Restore:
    """Restores a copy as docs/operations.md says, and returns the settings of a service on it."""

    def restored(service: Settings, copy: Path) -> Settings:
        database_url = artifact_url = None
        if service.database_url is not None:
            server = request.getfixturevalue("postgresql_server")
            database_url = server.url(server.create())
            dump = str(copy / "database.dump")
            subprocess.run(
                ["pg_restore", "--no-owner", "--exit-on-error", f"--dbname={database_url}", dump], check=True
            )
        if service.artifact_url is not None:
            artifact_url = f"{service.artifact_url}/restored"
            for part in PARTS:
                for file in (path for path in (copy / part).rglob("*") if path.is_file()):
                    blobs(artifact_url, part).write(str(file.relative_to(copy / part)), file.read_bytes())
        return Settings(data=copy, database_url=database_url, artifact_url=artifact_url)

    return restored


def test_a_copy_made_while_jobs_end_has_every_file_it_names(
    service: Settings, record: Record, restore: Restore, tmp_path: Path
) -> None:
    finish(service, record, "first")
    copied, begun = threading.Event(), threading.Event()
    written: list[str] = []

    def work() -> None:
        while not copied.is_set():
            written.append(finish(service, record, f"while it is copied {len(written)}"))
            begun.set()

    worker = threading.Thread(target=work)
    worker.start()
    begun.wait()
    try:
        made = back_up(service, tmp_path / "copy")
    finally:
        copied.set()
        worker.join()
    assert 2 <= made.jobs <= 1 + len(written)
    assert made.files >= made.jobs - 1, "one may have been running"
    engine = connect(restore(service, tmp_path / "copy"))
    there = Record(engine)
    listed = attacks(there)
    assert len(listed) == made.jobs
    ended = [job for job in listed if job.state is State.SUCCEEDED]
    assert len(ended) >= made.jobs - 1
    for job in ended:
        [artifact] = there.jobs.artifacts(job.id)
        assert (tmp_path / "copy" / "artifacts" / artifact.sha256[:2] / artifact.sha256).is_file()
    engine.dispose()


def test_a_service_starts_on_the_copy(service: Settings, record: Record, restore: Restore, tmp_path: Path) -> None:
    done = finish(service, record, "done")
    queued, running = add(record), add(record)
    start(record, running, seconds=-1)
    blobs(service.files, "assets").write("mesh", b"mesh")
    blobs(service.files, "checkpoints").write(running.id, b"of a running job")
    (tmp_path / "artifacts" / "half.part").parent.mkdir(exist_ok=True)
    (tmp_path / "artifacts" / "half.part").write_bytes(b"half")
    made = back_up(service, tmp_path / "copy")
    assert (made.jobs, made.files, made.size) == (3, 2, len("done") + len("mesh"))
    assert not list((tmp_path / "copy").rglob("*.part"))
    restored = restore(service, tmp_path / "copy")
    engine = connect(restored)
    migrate(engine, restored)
    there = Record(engine)
    assert there.leases.take_back() == [running.id]
    assert {job.id for job in attacks(there, "state:queued")} == {queued.id, running.id}
    [artifact] = there.jobs.artifacts(done)
    with ArtifactStore(restored.files).open(artifact.sha256) as file:
        assert file.read() == b"done"
    with blobs(restored.files, "assets").open("mesh") as file:
        assert file.read() == b"mesh"
    engine.dispose()


@pytest.mark.parametrize("how", ["missing", "damaged"])
def test_a_copy_that_lacks_an_artifact_is_none(service: Settings, record: Record, tmp_path: Path, how: str) -> None:
    job_id = finish(service, record, "lost")
    [artifact] = record.jobs.artifacts(job_id)
    name = f"{artifact.sha256[:2]}/{artifact.sha256}"
    if how == "missing":
        blobs(service.files, "artifacts").delete(name)
    else:
        blobs(service.files, "artifacts").write(name, b"another")
    with pytest.raises(JobFailure, match="1 of 1 artifacts are missing or damaged"):
        back_up(service, tmp_path / "copy")


def test_what_cannot_be_a_backup_is_refused(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(InvalidRequest, match="is not empty"):
        back_up(Settings(data=tmp_path), tmp_path)
    with pytest.raises(InvalidRequest, match="no database"):
        back_up(Settings(data=tmp_path / "nothing"), tmp_path / "copy")


def test_a_copy_of_sqlite_is_one_whole_file(tmp_path: Path) -> None:
    service = Settings(data=tmp_path)
    engine = connect(service)
    migrate(engine, service)
    back_up(service, tmp_path / "copy")
    engine.dispose()
    assert [path.name for path in (tmp_path / "copy").iterdir()] == ["jobs.sqlite"]
    with closing(sqlite3.connect(tmp_path / "copy" / "jobs.sqlite")) as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.parametrize("said", [None, "pg_dump (PostgreSQL) 9.6.24", "something else"])
def test_a_pg_dump_that_cannot_copy_the_server_is_refused(
    postgresql_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str | None
) -> None:
    programs = tmp_path / "programs"
    programs.mkdir()
    if said is not None:
        echo = shutil.which("echo")
        (programs / "pg_dump").write_text(f"#!/bin/sh\n{echo} '{said}'\n")
        (programs / "pg_dump").chmod(0o755)
    monkeypatch.setenv("PATH", str(programs))
    with pytest.raises(InvalidRequest, match=r"postgresql-client-\d+") as caught:
        back_up(Settings(data=tmp_path, database_url=postgresql_url), tmp_path / "copy")
    assert caught.value.field == "pg_dump"
    assert (said or "not on PATH") in str(caught.value)


def test_a_pg_dump_that_fails_says_why_and_gets_no_password_in_its_command_line(
    postgresql_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pg_dump").write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo "pg_dump (PostgreSQL) 99.0" && exit\necho "no room: $*" >&2\nexit 1\n'
    )
    (tmp_path / "pg_dump").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(JobFailure, match="pg_dump failed: no room: --format=custom") as caught:
        back_up(Settings(data=tmp_path, database_url=postgresql_url), tmp_path / "copy")
    password = make_url(postgresql_url).password
    assert password
    assert password not in str(caught.value)
    assert list((tmp_path / "copy").iterdir()) == []
