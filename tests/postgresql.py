"""A real PostgreSQL for tests: one server on loopback for all of them."""

import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg
from psycopg.sql import SQL, Identifier

from services.confinement.system_calls import die_with_parent
from services.jobs.database import connect, migrate
from services.jobs.models import Base
from services.settings import Settings

PATIENCE = 30.0
TIME_ZONE = "America/St_Johns"
"""Of the server, and so of its sessions: none that a test could agree with by chance."""


class Postgresql:
    """A running server. `password` is its only user's."""

    def __init__(self, port: int, password: str) -> None:
        self.port = port
        self._password = password

    def url(self, database: str) -> str:
        return f"postgresql://scene_attack:{self._password}@127.0.0.1:{self.port}/{database}"

    def create(self) -> str:
        """Creates an empty database and returns its name."""
        name = f"d{secrets.token_hex(8)}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(SQL("CREATE DATABASE {}").format(Identifier(name)))
        return name

    def empty(self, name: str) -> None:
        """Deletes all rows: ten times as fast as to make another database."""
        tables = [Identifier(table) for table in Base.metadata.tables]
        with psycopg.connect(self.url(name), autocommit=True) as connection:
            connection.execute(SQL("TRUNCATE {}").format(SQL(", ").join(tables)))

    def migrated(self) -> str:
        """Creates a database with the tables and returns its name."""
        name = self.create()
        engine = connect(Settings(database_url=self.url(name)))
        migrate(engine, Settings(database_url=self.url(name)))
        engine.dispose()
        return name


@contextmanager
def running() -> Iterator[Postgresql]:
    """Starts a server of its own in a directory of its own, and ends it on leaving. It refuses to run as root, so it
    then runs as another user.
    """
    # in /tmp, because another user cannot enter the directories of pytest
    directory = Path(tempfile.mkdtemp(prefix="scene-attack-postgresql-", dir="/tmp"))
    user = _other_user() if os.geteuid() == 0 else None
    if user is not None:
        os.chown(directory, user.pw_uid, user.pw_gid)
    who = {} if user is None else {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": ()}
    password = secrets.token_hex(16)
    try:
        (directory / "password").write_text(password)
        (directory / "password").chmod(0o644)
        made = [_program("initdb"), "--pgdata", str(directory / "data"), "--username=scene_attack", "--encoding=UTF8"]
        made += ["--auth=scram-sha-256", f"--pwfile={directory / 'password'}", "--locale=C.UTF-8", "--no-sync"]
        assert _start(made, who).wait(PATIENCE) == 0, "PostgreSQL could not be set up"
        port = free_port()
        options = {
            "listen_addresses": "127.0.0.1",
            "port": port,
            "unix_socket_directories": directory,
            "timezone": TIME_ZONE,
            "fsync": "off",
            "synchronous_commit": "off",
            "full_page_writes": "off",
            "shared_buffers": "32MB",
        }
        command = [_program("postgres"), "-D", str(directory / "data")]
        for name, value in options.items():
            command += ["-c", f"{name}={value}"]
        with _start(command, who) as process:
            server = Postgresql(port, password)
            try:
                _wait(server, process)
                yield server
            finally:
                process.send_signal(signal.SIGINT)  # a fast shutdown: connections are closed
                process.wait(PATIENCE)
    finally:
        shutil.rmtree(directory)


def _start(command: list[str], who: dict[str, object]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd="/",
        preexec_fn=die_with_parent,
        **who,  # type: ignore[call-overload]
    )


def _wait(server: Postgresql, process: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            psycopg.connect(server.url("postgres")).close()
            return
        except psycopg.OperationalError:
            assert process.poll() is None, "PostgreSQL did not start"
            assert time.monotonic() < deadline
            time.sleep(0.02)


def _other_user() -> pwd.struct_passwd:
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name)
        except KeyError:
            continue
    raise AssertionError("there is no user that PostgreSQL could run as")


def _program(name: str) -> str:
    """The path of a program of PostgreSQL; Debian keeps those of the server in a folder for each version."""
    found = shutil.which(name) or max(map(str, Path("/usr/lib/postgresql").glob(f"*/bin/{name}")), default=None)
    assert found is not None, "there is no PostgreSQL; scripts/setup --test installs it"
    return found


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])
