"""The databases of a run, and what can befall them. A PostgreSQL is started again when it dies or does not answer."""

import random
import signal
import sqlite3
import threading
import time
from pathlib import Path
from typing import Protocol

import psutil

from benchmarks.postgresql import Server

LOOK_SECONDS = 0.5
SILENT_SECONDS = 8.0
"""Time without an answer after which PostgreSQL is killed and started again; that of an embedded Redis is the same."""
LOCKED_SECONDS = (4.0, 14.0)
"""Shortest and longest time for which SQLite is locked; a transaction waits for ten seconds."""
PATIENCE = 300.0
"""Longest wait in seconds for SQLite's lock: a process that was stopped may hold it until it is killed."""
DATABASE, POSTMASTER, BACKEND = "database", "postmaster", "backend"


class Database(Protocol):
    """A database that can be killed and stopped."""

    name: str
    """Its program and version."""
    url: str | None
    killed: tuple[str, ...]
    """What of it can be killed."""

    def kill(self, target: str, draw: random.Random) -> bool:
        """Kills one of `killed`. Returns whether there was one."""

    def stop(self, draw: random.Random) -> None:
        """Makes it answer nobody for a while."""

    def keep_away(self, seconds: float) -> None:
        """Makes it answer nobody for `seconds`."""

    def end(self) -> None:
        """Ends it."""


class Sqlite:
    """The file of a service: it cannot die, but another program may hold its lock."""

    name = f"SQLite {sqlite3.sqlite_version}"
    url = None
    killed: tuple[str, ...] = ()

    def __init__(self, data: Path) -> None:
        self._file = data / "jobs.sqlite"

    def kill(self, target: str, draw: random.Random) -> bool:
        """There is nothing to kill."""
        raise NotImplementedError

    def stop(self, draw: random.Random) -> None:
        """Locks the file for some seconds."""
        self.keep_away(draw.uniform(*LOCKED_SECONDS))

    def keep_away(self, seconds: float) -> None:
        """Locks the file: nobody else can write. Under WAL, others still read."""
        connection = sqlite3.connect(self._file, timeout=PATIENCE, isolation_level=None)
        connection.execute("BEGIN EXCLUSIVE")
        time.sleep(seconds)
        connection.close()

    def end(self) -> None:
        """There is nothing to end."""


class Postgresql:
    """A server of its own and its manager: it starts the server again when it dies, or does not answer."""

    killed = (POSTMASTER, BACKEND)

    def __init__(self) -> None:
        self._server = Server({"shared_buffers": "32MB"})
        self._server.start()
        self._server.wait()
        self.url = self._server.url(self._server.create())
        self.name = f"PostgreSQL {self._server.version()}"
        self._ending = threading.Event()
        self._manager = threading.Thread(target=self._manage, daemon=True)
        self._manager.start()

    def kill(self, target: str, draw: random.Random) -> bool:
        """Kills the postmaster or, so that PostgreSQL ends all connections and recovers, the process of one of them."""
        running = self._server.processes()
        found = running[:1] if target == POSTMASTER else [one for one in running if _serves(one)]
        return bool(found) and _send(draw.choice(found), signal.SIGKILL)

    def stop(self, draw: random.Random) -> None:  # noqa: ARG002 - the manager decides how long it lasts
        """Stops all its processes, as its machine may."""
        self._send_all(signal.SIGSTOP)

    def keep_away(self, seconds: float) -> None:
        """Stops its processes whenever it is started again."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._send_all(signal.SIGSTOP)
            time.sleep(LOOK_SECONDS)

    def end(self) -> None:
        """Ends the server and removes its files."""
        self._ending.set()
        self._manager.join()
        self._send_all(signal.SIGKILL)  # it may be stopped
        self._server.stop()

    def _manage(self) -> None:
        heard = time.monotonic()
        while not self._ending.wait(LOOK_SECONDS):
            if self._server.answers():
                heard = time.monotonic()
            elif not self._server.runs() or time.monotonic() - heard > SILENT_SECONDS:
                self._send_all(signal.SIGKILL)  # some outlive their postmaster for a moment
                self._server.start()
                heard = time.monotonic()

    def _send_all(self, number: signal.Signals) -> None:
        for process in self._server.processes():
            _send(process, number)


def _serves(process: psutil.Process) -> bool:
    """Whether a process of PostgreSQL serves a connection of the service: its title then names its user."""
    try:
        return "scene_attack" in " ".join(process.cmdline())
    except psutil.Error:
        return False


def _send(process: psutil.Process, number: signal.Signals) -> bool:
    try:
        process.send_signal(number)
    except psutil.NoSuchProcess:
        return False
    return True
