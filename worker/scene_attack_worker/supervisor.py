"""Supervises programs: starts them, restarts a program that ends or hangs, and ends all of them together."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from scene_attack.confinement import die_with_parent
from scene_attack.logs import logger
from scene_attack_service.jobs import processes

POLL_SECONDS = 0.1
TICK_SECONDS = 1.0
"""Time between two calls of the supervisor's duty."""
STEADY_SECONDS = 10.0
"""A program that ran at least this long is restarted at once. Before, each failure doubles the wait and adds 0.1 s."""
LONGEST_WAIT = 5.0
"""Longest wait before a restart, in seconds."""
START_SECONDS = 180.0
"""Longest time that a program may take to start."""
ASK_SECONDS = 2.0
"""Time between two looks for signs of life."""
LONGEST_GAP = 5.0
"""Time between two looks beyond which the supervisor itself stood still, or the machine slept."""
STOP_SECONDS = 4.0
"""Time that programs have to end after SIGTERM, before they are killed."""

log = logger(__name__)


@dataclass
class Program:
    """A program to keep running. `command()` is called before each start, and `ended()` after each end.

    A program that hangs is killed. Either it sends signs of life (`scene_attack_service.jobs.processes`), or it is
    asked by `answers()`.
    """

    name: str
    command: Callable[[], Sequence[str]]
    environ: dict[str, str] = field(default_factory=dict)
    fds: Sequence[int] = ()
    ended: Callable[[], None] = lambda: None
    last: bool = False
    """Whether to stop it after the others, because they use it while they stop."""
    answers: Callable[[], bool] | None = None
    """Whether it answers now; None for a program that sends signs of life of its own."""
    silent_seconds: float = START_SECONDS
    """Time without a sign of life after which it hangs. One that sends signs has `START_SECONDS` before the first."""

    process: "subprocess.Popen[bytes] | None" = field(default=None, init=False)
    _started: float = field(default=0.0, init=False)
    _wait: float = field(default=0.0, init=False)
    _listener: processes.Listener | None = field(default=None, init=False)
    _asked: float = field(default=0.0, init=False)
    _silent: float = field(default=0.0, init=False)
    _heard: bool = field(default=False, init=False)

    def keep_running(self) -> None:
        """Starts the program if it does not run and the wait after its last end is over."""
        if self.process is not None:
            status = self.process.poll()
            if status is None:
                self._end_if_it_hangs(self.process)
                return
            lived = time.monotonic() - self._started
            self._wait = 0.0 if lived > STEADY_SECONDS else min(LONGEST_WAIT, 2 * self._wait + 0.1)
            log.warning("program ended", program=self.name, status=status, restart_in=self._wait)
            self.process = None
            self._started = time.monotonic()
            self.over()
        if time.monotonic() - self._started >= self._wait:
            self._start()

    def over(self) -> None:
        """Cleans up after its process has ended."""
        if self._listener is not None:
            self._listener.close()
        self.ended()

    def _end_if_it_hangs(self, process: "subprocess.Popen[bytes]") -> None:
        now = time.monotonic()
        gap = now - self._asked
        if gap < ASK_SECONDS:
            return
        self._asked = now
        assert self._listener is not None
        if self._listener.heard() if self.answers is None else self.answers():
            self._heard, self._silent = True, 0.0
            return
        self._silent += min(gap, LONGEST_GAP)
        if self._silent > (self.silent_seconds if self._heard or self.answers is not None else START_SECONDS):
            log.warning("program killed, it hangs", program=self.name, pid=process.pid)
            process.kill()

    def _start(self) -> None:
        self._listener = processes.Listener()
        self._heard, self._silent, self._asked = False, 0.0, time.monotonic()
        self.process = subprocess.Popen(
            list(self.command()),
            env=os.environ | self.environ | self._listener.environ,
            pass_fds=tuple(self.fds),
            stdin=subprocess.DEVNULL,
            stdout=sys.__stderr__,
            start_new_session=True,  # Ctrl-C then reaches the supervisor only, which stops the programs in order
            preexec_fn=die_with_parent,  # safe: a supervisor has one thread
        )
        self._started = time.monotonic()
        log.info("program started", program=self.name, pid=self.process.pid)


class Supervisor:
    """Keeps programs running and calls `duty` once a second, until `stop` or a signal."""

    def __init__(self, programs: Sequence[Program], duty: Callable[[], None]) -> None:
        self._programs = programs
        self._duty = duty
        self._stop = threading.Event()

    def run(self) -> None:
        """Blocks until SIGTERM, SIGINT or `stop()`, then ends all programs."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: self._stop.set())
        due = time.monotonic()
        processes.say_started()
        try:
            while not self._stop.is_set():
                processes.say_alive()
                for program in self._programs:
                    program.keep_running()
                if time.monotonic() >= due:
                    due = time.monotonic() + TICK_SECONDS
                    self._duty()
                self._stop.wait(POLL_SECONDS)
        finally:
            self._end([program for program in self._programs if not program.last])
            self._end([program for program in self._programs if program.last])

    def stop(self) -> None:
        """Makes `run` end all programs and return."""
        self._stop.set()

    def _end(self, programs: Sequence[Program]) -> None:
        running = [program for program in programs if program.process is not None]
        for program in running:
            assert program.process is not None
            program.process.terminate()
        deadline = time.monotonic() + STOP_SECONDS
        for program in running:
            assert program.process is not None
            try:
                program.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                log.warning("program killed, it did not stop", program=program.name)
                program.process.kill()
                program.process.wait()
            program.over()
