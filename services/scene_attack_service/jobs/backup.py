"""A consistent copy of a service's data while it runs.

The database is copied first, in one consistent state: SQLite by itself, PostgreSQL by pg_dump. Files never change and
are written before a row names them, so that the files copied afterwards hold everything that the copied database names.
"""

import hashlib
import os
import re
import shutil
import sqlite3
import subprocess
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Engine, func, select, text

from scene_attack import disk
from scene_attack.blobs import Blobs, blobs
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack_service.jobs.database import be_patient, check_database, connect
from scene_attack_service.jobs.models import Artifact, Job
from scene_attack_service.settings import Settings

SQLITE = "jobs.sqlite"
POSTGRESQL = "database.dump"
"""A dump for pg_restore."""
_VERSION = re.compile(r"\(PostgreSQL\) (\d+)")


@dataclass(frozen=True)
class DatabaseCopy:
    """Content of the copy of a database: its number of jobs, and the hashes of their artifacts."""

    jobs: int
    artifacts: frozenset[str]


def copy_database(engine: Engine, folder: Path) -> DatabaseCopy:
    """Copies the database into `folder`, as `SQLITE` or `POSTGRESQL`.

    Raises InvalidRequest("pg_dump") if that program is missing or older than the server, JobFailure("internal") if it
    fails, and SQLAlchemyError if the database does not answer.
    """
    if engine.dialect.name == "sqlite":
        return _copy_sqlite(engine, folder / SQLITE)
    with engine.connect().execution_options(isolation_level="REPEATABLE READ") as connection:
        be_patient(connection)
        program = _pg_dump(int(connection.scalar(text("SHOW server_version_num"))) // 10_000)
        # pg_dump sees what this transaction sees, and so do the queries
        snapshot = connection.scalar(text("SELECT pg_export_snapshot()"))
        content = _read(connection)
        with disk.replacing(folder / POSTGRESQL) as part:
            _dump(engine, [program, "--format=custom", "--no-owner", f"--snapshot={snapshot}", f"--file={part}"])
    return content


def _copy_sqlite(engine: Engine, goal: Path) -> DatabaseCopy:
    with engine.connect() as connection, disk.replacing(goal) as part, closing(sqlite3.connect(part)) as copy:
        source = connection.connection.driver_connection
        assert isinstance(source, sqlite3.Connection)
        source.backup(copy)  # one consistent state, whatever is written meanwhile
        copy.execute("PRAGMA journal_mode=DELETE")  # so that it is one file
        [[jobs]] = copy.execute("SELECT count(*) FROM jobs")
        return DatabaseCopy(jobs, frozenset(row[0] for row in copy.execute("SELECT DISTINCT sha256 FROM artifacts")))


def _read(connection: Connection) -> DatabaseCopy:
    jobs = connection.scalar(select(func.count()).select_from(Job)) or 0
    return DatabaseCopy(jobs, frozenset(connection.scalars(select(Artifact.sha256).distinct())))


def _pg_dump(server: int) -> str:
    """The path of a pg_dump that can read a server of this major version."""
    remedy = f"install PostgreSQL's client programs, version {server} or newer (Debian: postgresql-client-{server})"
    program = shutil.which("pg_dump")
    if program is None:
        raise InvalidRequest("pg_dump", f"the program is not on PATH; {remedy}")
    output = subprocess.run([program, "--version"], capture_output=True, text=True, check=False).stdout
    version = _VERSION.search(output)
    if version is None or int(version[1]) < server:
        raise InvalidRequest("pg_dump", f"{output.strip() or program} cannot copy PostgreSQL {server}; {remedy}")
    return program


def _dump(engine: Engine, command: list[str]) -> None:
    password = engine.url.password
    url = engine.url.set(drivername="postgresql")._replace(password=None)
    environ = os.environ | ({} if password is None else {"PGPASSWORD": str(password)})  # no other user may read it
    ended = subprocess.run(
        [*command, f"--dbname={url.render_as_string()}"],
        env=environ,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode:
        raise JobFailure("internal", f"pg_dump failed: {ended.stderr.strip()[-500:]}")


PARTS = ("artifacts", "assets")
"""Folders of the artifact store that are copied. The others belong to running jobs, which begin again without."""
_CHUNK_BYTES = 2**20


@dataclass(frozen=True)
class Backup:
    """Content of a backup: the number of files, their size in bytes, and the number of jobs."""

    files: int
    size: int
    jobs: int


def back_up(settings: Settings, folder: Path) -> Backup:
    """Copies the database and all artifacts and assets into `folder`, which is made.

    Raises InvalidRequest("FOLDER") if there is something in the folder, JobFailure("internal") if a file that the
    database names is missing or damaged: it was deleted meanwhile, or long ago; what `check_database` and
    `copy_database` raise, and OSError if a file cannot be read or written.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InvalidRequest("FOLDER", f"{folder} is not empty; name one that does not exist yet")
    if settings.database_url is None and not (settings.data_dir / SQLITE).exists():
        raise InvalidRequest("--data", f"there is no database in {settings.data_dir}")
    engine = connect(settings)
    try:
        check_database(engine, settings)
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        copied = copy_database(engine, folder)
    finally:
        engine.dispose()
    files, size, whole = 0, 0, set()
    for part in PARTS:
        source = blobs(settings.files, part)
        for name in source.names():
            written = _copy(source, name, folder / part / name)
            if written is not None:
                sha256, length = written
                files, size = files + 1, size + length
                if sha256 == Path(name).name:
                    whole.add(sha256)
    _check(copied.artifacts, whole)
    return Backup(files, size, copied.jobs)


def _copy(source: Blobs, name: str, goal: Path) -> tuple[str, int] | None:
    """Copies a file and returns its SHA-256 and its size in bytes; None if it was deleted meanwhile."""
    try:
        file = source.open(name)
    except FileNotFoundError:  # `_check` says if the database names it
        return None
    digest, size = hashlib.sha256(), 0
    with file, disk.replacing(goal) as part, part.open("wb") as copy:
        while chunk := file.read(_CHUNK_BYTES):
            copy.write(chunk)
            digest.update(chunk)
            size += len(chunk)
    return digest.hexdigest(), size


def _check(named: frozenset[str], whole: set[str]) -> None:
    """Raises JobFailure if the copies of some artifacts that the database names are missing or damaged."""
    missing = sorted(named - whole)
    if missing:
        detail = f"{len(missing)} of {len(named)} artifacts are missing or damaged, such as {missing[0]}; back up again"
        raise JobFailure("internal", detail)
