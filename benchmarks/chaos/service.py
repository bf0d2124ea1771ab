"""A service of its own, and its manager: as systemd would, it starts the service again when it dies or hangs."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil

from services.jobs.watchdog import Listener
from services.settings import Settings

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
        found = []
        try:
            for process in psutil.Process(running.pid).children(recursive=True):
                if _is(process, target):
                    found.append(process)
        except psutil.NoSuchProcess:
            pass
        return found

    def end(self) -> None:
        """Ends the service as Ctrl-C does, and then kills what is left of it."""
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
                [sys.executable, "-m", "client", "serve"],
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
