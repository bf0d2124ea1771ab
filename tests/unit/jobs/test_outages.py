"""Outages are made for real: a full disk, a directory that cannot be written, a locked database."""

import os
import sqlite3
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import fsspec
import psycopg
import pytest
import torch
from redis import Redis
from safetensors.torch import save_file
from sqlalchemy import Engine, event, text
from sqlalchemy.exc import SQLAlchemyError

from scene_attack.disk import replacing
from scene_attack.disk import write as write_file
from scene_attack_service.jobs.database import Outage, be_patient, connect, migrate, outage_of
from scene_attack_service.jobs.files import ArtifactStore, Storage
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from tests.postgresql import free_port
from tests.unit.jobs.records import add

pytestmark = pytest.mark.slow

FULL = Outage("storage", "the disk of the data directory is full")
AWAY = Outage("database", "the database does not answer")
SIZE = 20 * 2**20


def mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True)


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 20 MB."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount a disk")
    folder = tmp_path / "disk"
    folder.mkdir()
    mount("-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder))
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder: Path) -> Path:
    """Writes a file until the disk is full."""
    file = folder / "fills-the-disk"
    with file.open("wb", buffering=0) as out:
        try:
            while out.write(bytes(2**16)):
                pass
        except OSError:
            pass
    return file


def add_many(record: Record) -> None:
    for _ in range(1000):
        add(record)


def test_a_full_disk_is_named_and_leaves_nothing_half_written(disk: Path) -> None:
    storage = Storage(disk)
    assert storage.usable()
    write_file(disk / "file", b"old")
    fill(disk)
    writers: list[Callable[[Path], None]] = [
        lambda path: path.write_bytes(bytes(2**20)),
        lambda path: save_file({"x": torch.zeros(2**18)}, path),
    ]
    for write in writers:
        with (
            pytest.raises(Exception, match=r"No space|os error 28") as caught,
            replacing(disk / "file") as part,
        ):
            write(part)
        assert outage_of(caught.value) == FULL
    assert (disk / "file").read_bytes() == b"old"
    assert sorted(path.name for path in disk.iterdir()) == ["file", "fills-the-disk"]
    assert not Storage(disk).usable()


def test_a_job_is_not_recorded_on_a_full_disk_and_is_afterwards(disk: Path) -> None:
    settings = Settings(data=disk)
    engine = connect(settings)
    migrate(engine, settings)
    record = Record(engine)
    kept = add(record)
    file = fill(disk)
    with pytest.raises(SQLAlchemyError) as caught:
        add_many(record)  # what the database has allocated is used up first
    assert outage_of(caught.value) == FULL
    assert record.jobs.get(kept.id) is not None
    file.unlink()
    add(record)
    engine.dispose()


def test_a_read_only_disk_is_named(disk: Path) -> None:
    settings = Settings(data=disk)
    engine = connect(settings)
    migrate(engine, settings)
    engine.dispose()
    mount("-o", "remount,ro", str(disk))
    with pytest.raises(OSError, match="Read-only") as caught:
        write_file(disk / "file", b"new")
    assert outage_of(caught.value) == Outage("storage", "the data directory is read-only")
    with pytest.raises(SQLAlchemyError) as failed:
        add(Record(engine))
    assert outage_of(failed.value) == AWAY  # it cannot open its log
    assert not Storage(disk).usable()
    engine.dispose()


def test_a_locked_database_and_one_that_has_gone_do_not_answer(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, stall_seconds=0.04)
    engine = connect(settings)
    migrate(engine, settings)
    record = Record(engine)
    other = sqlite3.connect(tmp_path / "jobs.sqlite")
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(SQLAlchemyError) as locked:
        add(record)
    assert outage_of(locked.value) == AWAY
    other.rollback()
    other.close()
    engine.dispose()
    for path in tmp_path.glob("jobs.sqlite*"):
        path.rename(tmp_path / f"away-{path.name}")
    with pytest.raises(SQLAlchemyError) as gone:
        record.database.ping()
    assert outage_of(gone.value) == AWAY
    assert not (tmp_path / "jobs.sqlite").exists()  # an empty one in its place would hide that it has gone
    for path in tmp_path.glob("away-*"):
        path.rename(tmp_path / path.name.removeprefix("away-"))
    record.database.ping()
    engine.dispose()


@pytest.mark.parametrize("database", ["postgresql"], indirect=True)
def test_a_database_that_was_made_read_only_is_named(engine: Engine, record: Record) -> None:
    """A standby, or a server whose disk is nearly full. Its driver does not call this an operational error."""
    event.listen(engine, "begin", lambda connection: connection.exec_driver_sql("SET TRANSACTION READ ONLY"))
    with pytest.raises(SQLAlchemyError) as caught:
        add(record)
    assert outage_of(caught.value) == Outage("database", "the database is read-only")


def test_redis_is_named_and_faults_are_no_outages(tmp_path: Path) -> None:
    with pytest.raises(Exception, match="connecting") as caught, Redis.from_url(f"unix://{tmp_path}/none") as client:
        client.ping()
    assert outage_of(caught.value) == Outage("redis", "Redis does not answer")
    for error in (ValueError("x"), FileNotFoundError(2, "gone"), MemoryError(), None):
        assert outage_of(error) is None
    wrapped = RuntimeError("a plug-in wraps it")
    wrapped.__cause__ = OSError(28, "No space left on device")
    assert outage_of(wrapped) == FULL


@pytest.fixture
def hasty(postgresql_url: str) -> Iterator[Engine]:
    """A PostgreSQL that is waited for only a moment."""
    engine = connect(Settings(database_url=postgresql_url, stall_seconds=2))  # 0.5 s for a lock, 0.75 s for an answer
    yield engine
    engine.dispose()


def test_a_postgresql_that_says_nothing_does_not_answer(hasty: Engine) -> None:
    with pytest.raises(SQLAlchemyError) as silent, hasty.connect() as connection:
        connection.execute(text("SELECT pg_sleep(600)"))
    assert outage_of(silent.value) == AWAY
    Record(hasty).database.ping()  # on another connection, which does not take the late answer for its own


def test_a_command_waits_as_long_as_postgresql_takes(hasty: Engine) -> None:
    with hasty.connect() as connection:
        be_patient(connection)
        connection.execute(text("SELECT pg_sleep(1)"))
        driver = connection.connection.dbapi_connection
    with hasty.connect() as other:
        assert other.connection.dbapi_connection is not driver, "it is no connection of the service's"


def test_a_postgresql_whose_lock_another_holds_does_not_answer(hasty: Engine, postgresql_url: str) -> None:
    record = Record(hasty)
    job = add(record)
    with psycopg.connect(postgresql_url) as other:
        other.execute("SELECT id FROM jobs FOR UPDATE")
        with pytest.raises(SQLAlchemyError) as locked:
            record.jobs.request_cancel(job.id)
        assert outage_of(locked.value) == AWAY
    assert record.jobs.request_cancel(job.id) is not None


def test_a_process_that_stands_still_in_a_transaction_loses_its_locks(hasty: Engine) -> None:
    record = Record(hasty)
    job = add(record)
    with hasty.connect() as still:
        still.execute(text("SELECT id FROM jobs FOR UPDATE"))
        while still_locked(record, job.id):
            pass
        with pytest.raises(SQLAlchemyError) as ended:
            still.execute(text("SELECT 1"))
    assert outage_of(ended.value) == AWAY


def still_locked(record: Record, job_id: str) -> bool:
    try:
        record.jobs.request_cancel(job_id)
    except SQLAlchemyError:
        return True
    return False


def test_a_store_of_artifacts_that_is_away_is_an_outage_that_can_be_seen(
    s3_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert Storage(tmp_path, ArtifactStore(s3_url)).usable()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free_port()}")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    assert not Storage(tmp_path, ArtifactStore(s3_url)).usable()
    fsspec.get_filesystem_class("s3").clear_instance_cache()
