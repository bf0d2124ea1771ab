"""Faults: chooses the processes to kill or stop, and kills or stops them."""

import random
import signal
import time
from dataclasses import dataclass

import psutil

from benchmarks.chaos.service import DATABASE, Database, Service

RUNNING = ("worker.job_process", "worker.rq_worker")
"""Processes that run jobs. They are hit while a job takes steps."""
OTHERS = ("redis-server", "supervisor", "api.main", "services.jobs.warm_process")
"""Other processes that can die: modules of the service, a program that it runs, and the supervisor, which is started
again."""
PATIENCE = 30.0
"""Time in seconds to wait for a process that is to be hit: it may have been hit just before."""


@dataclass(frozen=True)
class Fault:
    """A fault: its kind, its process and its time (POSIX)."""

    kind: str
    target: str
    at: float


def plan(kills: int, stops: int, seed: int, of_database: tuple[str, ...] = ()) -> list[tuple[str, str]]:
    """Faults as (kind, target) in a random order, each target about as often as any other. `of_database` names the
    parts of the database that can be killed; it is always stopped as a whole.
    """
    draw = random.Random(seed)
    faults = []
    for kind, count, database in (("kill", kills, of_database), ("stop", stops, (DATABASE,))):
        targets = (*RUNNING, *database, *OTHERS)
        order = [targets[number % len(targets)] for number in range(count)]
        faults += [(kind, target) for target in order]
    draw.shuffle(faults)
    return faults


def hit(service: Service, database: Database, kind: str, target: str, draw: random.Random) -> Fault | None:
    """Kills (SIGKILL) or stops (SIGSTOP) one of the target's processes. Returns None if there is none for long."""
    if target == DATABASE:
        began = time.time()
        database.stop(draw)
        return Fault(kind, target, began)
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        met = database.kill(target, draw) if target in database.killed else _send(service, kind, target, draw)
        if met:
            return Fault(kind, target, time.time())
        time.sleep(0.1)
    return None


def _send(service: Service, kind: str, target: str, draw: random.Random) -> bool:
    living = service.processes(target)
    if not living:
        return False
    try:
        draw.choice(living).send_signal(signal.SIGKILL if kind == "kill" else signal.SIGSTOP)
    except psutil.NoSuchProcess:
        return False
    return True


def keep_away(service: Service, database: Database, target: str, seconds: float) -> Fault:
    """Stops a program whenever it is started again, or the database, for `seconds`."""
    began, deadline = time.time(), time.monotonic() + seconds
    if target == DATABASE:
        database.keep_away(seconds)
    while time.monotonic() < deadline:
        for process in service.processes(target):
            try:
                if process.status() != psutil.STATUS_STOPPED:
                    process.send_signal(signal.SIGSTOP)
            except psutil.NoSuchProcess:
                continue
        time.sleep(0.05)
    return Fault("away", target, began)
