"""A service of its own with its database, and their managers: as systemd would, they start what dies or hangs again."""

import os
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Protocol

import psutil

from benchmarks.postgresql import Server
from scene_attack_service.jobs.processes import Listener
from scene_attack_service.settings import Settings

START_SECONDS = 60.0
"""Time without a sign of life after which a service that has given none yet is taken to hang."""
LOOK_SECONDS = 0.2


class Service:
    """`scene-attack serve` with settings of its own. It hangs if it gives no sign of life for `watchdog_seconds`."""

    def __init__(self, settings: Settings, log: Path, watchdog_seconds: float) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:  # the same port after each start
            port = free.getsockname()[1]
        self.settings = settings.model_copy(update={"port": port})
        self.url = f"http://127.0.0.1:{port}"
        self.starts = 0
        self._log = log
        self._watchdog_seconds = watchdog_seconds
        self._ending = threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._manager = threading.Thread(target=self._manage, daemon=True)
        self._manager.start()

    def processes(self, target: str) -> list[psutil.Process]:
        """The living processes of the service that run a module, or the program of this name."""
        running = self._process
        if running is None:
            return []
        if target == "supervisor":
            return [psutil.Process(running.pid)] if running.poll() is None else []
        living = []
        try:
            for process in psutil.Process(running.pid).children(recursive=True):
                if _is(process, target):
                    living.append(process)
        except psutil.NoSuchProcess:
            pass
        return living

    def end(self) -> None:
        """Ends the service as Ctrl-C does, and then kills its remaining processes."""
        self._ending.set()
        self._manager.join()
        process = self._process
        if process is None or process.poll() is not None:
            return
        tree = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGINT)
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for left in psutil.wait_procs(tree, timeout=10)[1]:
            left.kill()

    def _manage(self) -> None:
        while not self._ending.is_set():
            listener = Listener()
            self._process = self._start(listener)
            self._wait(self._process, listener)
            listener.close()

    def _start(self, listener: Listener) -> "subprocess.Popen[bytes]":
        self.starts += 1
        with self._log.open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "scene_attack", "serve"],
                env=os.environ | self.settings.environ() | listener.environ,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )

    def _wait(self, process: "subprocess.Popen[bytes]", listener: Listener) -> None:
        """Waits until the service has ended, killing it if it hangs, or until it is to end."""
        heard, allowed = time.monotonic(), START_SECONDS
        while process.poll() is None and not self._ending.wait(LOOK_SECONDS):
            if listener.heard():
                heard, allowed = time.monotonic(), self._watchdog_seconds
            if time.monotonic() - heard > allowed:
                process.kill()
                process.wait()


def _is(process: psutil.Process, target: str) -> bool:
    try:
        runs = target in process.cmdline() or process.name() == target
        return bool(runs and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


BEAT_SECONDS = 0.5
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
    """Its parts that can be killed."""

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
        victims = running[:1] if target == POSTMASTER else [process for process in running if _serves(process)]
        return bool(victims) and _send(draw.choice(victims), signal.SIGKILL)

    def stop(self, draw: random.Random) -> None:  # noqa: ARG002 - the manager decides how long it lasts
        """Stops all its processes, as its machine may."""
        self._send_all(signal.SIGSTOP)

    def keep_away(self, seconds: float) -> None:
        """Stops its processes whenever it is started again."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._send_all(signal.SIGSTOP)
            time.sleep(BEAT_SECONDS)

    def end(self) -> None:
        """Ends the server and removes its files."""
        self._ending.set()
        self._manager.join()
        self._send_all(signal.SIGKILL)  # it may be stopped
        self._server.stop()

    def _manage(self) -> None:
        heard = time.monotonic()
        while not self._ending.wait(BEAT_SECONDS):
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
