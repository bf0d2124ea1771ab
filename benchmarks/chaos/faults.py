"""The faults: which process is killed or stopped next, and the doing of it."""

import random
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass

import psutil

from benchmarks.chaos.service import Service

PROCESSES = (
    "worker.job_process",
    "worker.rq_worker",
    "api.main",
    "services.jobs.preflight_process",
    "redis-server",
    "supervisor",
)
"""What can die: modules of the service, a program that it runs, and the supervisor, which the harness starts again."""
RUNNING = PROCESSES[:2]
"""What runs jobs. They are hit while a job takes steps."""
PATIENCE = 30.0
"""Time in seconds to wait for a process that is to be hit: it may have been hit just before."""


@dataclass(frozen=True)
class Fault:
    """What happened to which process, and when (POSIX time)."""

    kind: str
    target: str
    at: float


def plan(kills: int, stops: int, seed: int, targets: tuple[str, ...] = PROCESSES) -> list[tuple[str, str]]:
    """Faults as (kind, target) in a random order, each target about as often as any other."""
    draw = random.Random(seed)
    found = []
    for kind, count in (("kill", kills), ("stop", stops)):
        order = [targets[number % len(targets)] for number in range(count)]
        found += [(kind, target) for target in order]
    draw.shuffle(found)
    return found


def hit(service: Service, kind: str, target: str, draw: random.Random) -> Fault | None:
    """Kills (SIGKILL) or stops (SIGSTOP) one of the target's processes. Returns None if there is none for long."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        living = service.processes(target)
        if living:
            try:
                draw.choice(living).send_signal(signal.SIGKILL if kind == "kill" else signal.SIGSTOP)
            except psutil.NoSuchProcess:
                continue
            return Fault(kind, target, time.time())
        time.sleep(0.1)
    return None


def keep_away(service: Service, target: str, seconds: float, over: Callable[[], bool]) -> Fault:
    """Stops a program whenever it is started again, for `seconds` or until `over()`."""
    began, deadline = time.time(), time.monotonic() + seconds
    while time.monotonic() < deadline and not over():
        for process in service.processes(target):
            try:
                if process.status() != psutil.STATUS_STOPPED:
                    process.send_signal(signal.SIGSTOP)
            except psutil.NoSuchProcess:
                continue
        time.sleep(0.05)
    return Fault("away", target, began)
