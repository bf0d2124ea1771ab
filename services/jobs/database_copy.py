"""Copies a service's database in one consistent state while it is in use: SQLite by itself, PostgreSQL by pg_dump."""

import os
import re
import shutil
import sqlite3
import subprocess
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, Engine, func, select, text

from services import atomic_write
from services.errors import InvalidRequest, JobFailure
from services.jobs.database import be_patient
from services.jobs.models import Artifact, Job

SQLITE = "jobs.sqlite"
POSTGRESQL = "database.dump"
"""A dump for pg_restore."""
_VERSION = re.compile(r"\(PostgreSQL\) (\d+)")


@dataclass(frozen=True)
class DatabaseCopy:
    """What the copy of a database names: its number of jobs, and the hashes of their artifacts."""

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
        found = _read(connection)
        with atomic_write.replacing(folder / POSTGRESQL) as part:
            _dump(engine, [program, "--format=custom", "--no-owner", f"--snapshot={snapshot}", f"--file={part}"])
    return found


def _copy_sqlite(engine: Engine, goal: Path) -> DatabaseCopy:
    with engine.connect() as connection, atomic_write.replacing(goal) as part, closing(sqlite3.connect(part)) as copy:
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
    said = subprocess.run([program, "--version"], capture_output=True, text=True, check=False).stdout
    version = _VERSION.search(said)
    if version is None or int(version[1]) < server:
        raise InvalidRequest("pg_dump", f"{said.strip() or program} cannot copy PostgreSQL {server}; {remedy}")
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
