"""A PostgreSQL server of one's own on loopback, for the tests and for the load that kills and stops it."""

import os
import pwd
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import psutil
import psycopg
from psycopg.sql import SQL, Identifier

from scene_attack.confinement import die_with_parent

PATIENCE = 30.0
"""Longest time in seconds to set up, start or end a server."""
ANSWER_SECONDS = 2


class Server:
    """A server in a directory of its own. It refuses to run as root, so it then runs as another user."""

    def __init__(self, options: Mapping[str, object]) -> None:
        """Sets up the server, which `start` starts with `options` of its configuration."""
        # in /tmp, because another user cannot enter the directories of pytest
        self._directory = Path(tempfile.mkdtemp(prefix="scene-attack-postgresql-", dir="/tmp"))
        self._data = self._directory / "data"
        self._who: dict[str, Any] = {}
        if os.geteuid() == 0:
            user = _other_user()
            os.chown(self._directory, user.pw_uid, user.pw_gid)
            self._who = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": ()}
        self._password = secrets.token_hex(16)
        file = self._directory / "password"
        file.write_text(self._password)
        file.chmod(0o644)
        command = [_program("initdb"), "--pgdata", str(self._data), "--username=scene_attack", "--encoding=UTF8"]
        command += ["--auth=scram-sha-256", f"--pwfile={file}", "--locale=C.UTF-8", "--no-sync"]
        assert self._run(command).wait(PATIENCE) == 0, "PostgreSQL could not be set up"
        own = {"listen_addresses": "127.0.0.1", "port": free_port(), "unix_socket_directories": self._directory}
        self.port = own["port"]
        self._command = [_program("postgres"), "-D", str(self._data)]
        for name, value in (own | dict(options)).items():
            self._command += ["-c", f"{name}={value}"]
        self._process: subprocess.Popen[bytes] | None = None

    def url(self, database: str) -> str:
        """The URL of a database, with the password of the server's only user."""
        return f"postgresql://scene_attack:{self._password}@127.0.0.1:{self.port}/{database}"

    def create(self) -> str:
        """Creates an empty database and returns its name."""
        name = f"d{secrets.token_hex(8)}"
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            connection.execute(SQL("CREATE DATABASE {}").format(Identifier(name)))
        return name

    def version(self) -> str:
        """The version of the running server."""
        with psycopg.connect(self.url("postgres")) as connection:
            return str(connection.info.parameter_status("server_version"))

    def start(self) -> None:
        """Starts the server, again once it has been killed; the thread that does so must outlive it. Returns without
        waiting until it answers.
        """
        if self._process is not None:
            self._process.wait(PATIENCE)  # else its number is still taken, and the new one believes that it runs
        self._process = self._run(self._command)

    def wait(self) -> None:
        """Waits until the server answers."""
        deadline = time.monotonic() + PATIENCE
        while not self.answers():
            assert self.runs(), "PostgreSQL did not start"
            assert time.monotonic() < deadline, "PostgreSQL does not answer"
            time.sleep(0.02)

    def runs(self) -> bool:
        """Whether the postmaster lives."""
        return self._process is not None and self._process.poll() is None

    def answers(self) -> bool:
        """Whether the server takes connections and answers queries."""
        try:
            with psycopg.connect(self.url("postgres"), connect_timeout=ANSWER_SECONDS):
                return True
        except psycopg.Error:
            return False

    def processes(self) -> list[psutil.Process]:
        """The living processes of the server, the postmaster first. All work in the data directory."""
        living = []
        for process in psutil.process_iter():
            try:
                if process.cwd() == str(self._data) and process.status() != psutil.STATUS_ZOMBIE:
                    living.append(process)
            except psutil.Error:
                continue
        postmaster = None if self._process is None else self._process.pid
        return sorted(living, key=lambda process: (process.pid != postmaster, process.pid))

    def stop(self) -> None:
        """Ends the server and removes its directory."""
        if self._process is not None and self.runs():
            self._process.send_signal(signal.SIGINT)  # a fast shutdown: connections are closed
            self._process.wait(PATIENCE)
        shutil.rmtree(self._directory)

    def _run(self, command: list[str]) -> "subprocess.Popen[bytes]":
        return subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd="/",
            preexec_fn=die_with_parent,
            **self._who,
        )


def _other_user() -> pwd.struct_passwd:
    for name in ("postgres", "nobody"):
        try:
            return pwd.getpwnam(name)
        except KeyError:
            continue
    raise AssertionError("there is no user that PostgreSQL could run as")


def _program(name: str) -> str:
    """The path of a program of PostgreSQL; Debian keeps those of the server in a folder for each version."""
    program = shutil.which(name) or max(map(str, Path("/usr/lib/postgresql").glob(f"*/bin/{name}")), default=None)
    assert program is not None, "there is no PostgreSQL; scripts/setup --test installs it"
    return program


def free_port() -> int:
    """A port of loopback that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])
