"""One run: jobs are submitted while their service is hit, and every one is compared with an undisturbed one.

The jobs are small enough to run many: attacks with and without gradients, on the image and through both renderers.
"""

import random
import signal
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import psutil
from sqlalchemy import Engine, func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.sql.elements import ColumnElement

from benchmarks.chaos.counts import Client, counts
from benchmarks.chaos.service import DATABASE, Database, Postgresql, Service, Sqlite
from scene_attack_service.jobs.database import connect
from scene_attack_service.jobs.models import Job, State
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings

AHEAD = 3
"""Jobs that wait or run at a time, for each worker."""


@dataclass(frozen=True)
class Load:
    """Settings of a run. Times in seconds; a process that hangs is killed after `stall` or `watchdog`."""

    jobs: int
    workers: int
    kills: int
    stops: int
    steps: int = 120
    seed: int = 0
    stall: float = 40.0
    watchdog: float = 60.0
    away: bool = True
    """Whether Redis, and then the database, is once away for longer than the longest job takes."""
    pause: float = 4.0
    """Longest time between two faults that are due."""
    patience: float = 900.0
    """Time without any job ending after which the run has failed."""
    database: Literal["sqlite", "postgresql"] = "sqlite"
    log: Path | None = None
    """Path of the service's log."""


def run(load: Load) -> dict[str, Any]:
    """Runs the load and returns its counts. "ok" is whether every job has one result, the same as undisturbed."""
    with tempfile.TemporaryDirectory(prefix="scene-attack-chaos-") as name, ExitStack() as stack:
        data = Path(name) / "data"
        database: Database = Postgresql() if load.database == "postgresql" else Sqlite(data)
        stack.callback(database.end)
        service = stack.enter_context(_served(load, data, database, load.log or Path(name) / "log"))
        client = Client(service.url, load.patience)
        stack.callback(client.close)
        engine = connect(service.settings)
        stack.callback(engine.dispose)
        return _run(load, service, database, client, engine)


def _run(load: Load, service: Service, database: Database, client: Client, engine: Engine) -> dict[str, Any]:
    undisturbed, longest = _reference(load, client)
    client.errors.clear()
    began = time.monotonic()
    known = _ended(engine)
    ids: list[str] = []

    def submit() -> None:
        for number, request in enumerate(requests(load.jobs, load.steps)):
            while number - (_ended(engine) - known) >= AHEAD * load.workers:  # so that faults meet submissions too
                time.sleep(0.1)
            ids.append(client.submit(request, f"chaos-{load.seed}-{number}"))

    sender = threading.Thread(target=submit, daemon=True)
    sender.start()
    faults, missed = _hit_all(load, service, database, engine, known, longest)
    sender.join(load.patience)
    _until(load, lambda: _ended(engine) - known >= load.jobs, engine)
    seconds = time.monotonic() - began
    return counts(client, Record(engine), ids, undisturbed) | {
        "database": database.name,
        "backend": client.job(ids[0])["result"]["provenance"]["backend"],
        "seconds": round(seconds, 1),
        "starts of the service": service.starts,
        "faults": dict(sorted(faults.items())),
        "faults that met no process": missed,
        "refused or broken requests": dict(client.errors),
    }


@contextmanager
def _served(load: Load, data: Path, database: Database, log: Path) -> Iterator[Service]:
    settings = Settings(
        data=data,
        database_url=database.url,
        workers=load.workers,
        threads=1,
        stall_seconds=load.stall,
        max_queued=max(1000, 2 * load.jobs),
    )
    service = Service(settings, log, load.watchdog)
    try:
        yield service
    except BaseException:
        print(log.read_text()[-20_000:])
        raise
    finally:
        service.end()


def _reference(load: Load, client: Client) -> tuple[list[dict[str, str]], float]:
    """The files of each kind of job, undisturbed, and the seconds that the longest took to run."""
    ids = [client.submit(request, f"undisturbed-{n}") for n, request in enumerate(mixed(load.steps))]
    longest = 0.0
    for job_id in ids:
        while (job := client.job(job_id))["state"] in ("queued", "running"):
            time.sleep(0.2)
        if job["state"] != "succeeded":
            raise RuntimeError(f"an undisturbed job {job['state']}: {job['failure']}")
        longest = max(longest, float(job["result"]["cost"]["seconds"]))
    return [client.files(job_id) for job_id in ids], longest


def _hit_all(
    load: Load, service: Service, database: Database, engine: Engine, known: int, longest: float
) -> tuple[Counter[str], int]:
    """Hits the service until all faults are done, spread evenly over the jobs. Returns their number of each kind and
    target, and the number of those that met no process.
    """
    draw = random.Random(load.seed)
    done: Counter[str] = Counter()
    missed = 0
    planned = plan(load.kills, load.stops, load.seed, database.killed)
    away = {len(planned) // 2: "redis-server", 3 * len(planned) // 4: DATABASE} if load.away else {}
    for number, (kind, target) in enumerate(planned):
        due = known + number * load.jobs // (len(planned) + 1)
        _until(load, lambda due=due: _ended(engine) >= due, engine)  # type: ignore[misc]
        time.sleep(draw.uniform(0.1, load.pause))
        if number in away:
            keep_away(service, database, away[number], 1.5 * longest)
            done[f"away {away[number]}"] += 1
        if target in RUNNING:
            _wait_for_a_step(engine)
        if hit(service, database, kind, target, draw):
            done[f"{kind} {target}"] += 1
        else:
            missed += 1
    return done, missed


def _until(load: Load, met: Any, engine: Engine) -> None:
    ended, since = _ended(engine), time.monotonic()
    while not met():
        time.sleep(0.2)
        now = _ended(engine)
        if now != ended:
            ended, since = now, time.monotonic()
        if time.monotonic() - since > load.patience:
            raise TimeoutError(f"no job ended within {load.patience:g} s")


def _ended(engine: Engine) -> int:
    """The number of jobs that have ended, read from the record once it answers."""
    over = [state for state in State if state.terminal]
    return _count(engine, Job.state.in_(over))


def _wait_for_a_step(engine: Engine) -> None:
    """Waits until a job takes steps, so that a fault of their processes meets one; not for long if there is none."""
    deadline = time.monotonic() + PATIENCE
    while not _count(engine, Job.state == State.RUNNING, Job.phase == "attacking") and time.monotonic() < deadline:
        time.sleep(0.02)


def _count(engine: Engine, *where: ColumnElement[bool]) -> int:
    while True:
        try:
            with engine.connect() as connection:
                return connection.scalar(select(func.count()).select_from(Job).where(*where)) or 0
        except SQLAlchemyError:
            time.sleep(0.2)


def _scene(mesh: str, size: int = 64) -> dict[str, Any]:
    return {"camera": {"size": [size, size]}, "objects": [{"mesh": mesh}]}


def _held(steps: int, **attack: Any) -> dict[str, Any]:
    """An attack that takes all its steps: towards a label that it cannot reach with steps so small."""
    return {"goal": {"reach": "tench"}, "attack": {"steps": steps, **attack}}


def mixed(steps: int) -> list[dict[str, Any]]:
    """The requests of one job of each kind; the longest ones take `steps` steps."""
    image = {"renderer": "image", "base_renderer": "pyrender"}
    tiny = {"learning_rate": {"image": 1e-6}}
    sphere, cube = _scene("primitive/sphere"), _scene("primitive/cube")
    return [
        {"scene": sphere, "attack": image | {"steps": 3}},
        {"scene": sphere, **_held(steps, **image, **tiny)},
        {"scene": cube, **_held(steps // 2, **image, method="mi-fgsm", **tiny)},
        {"scene": cube, **_held(steps // 4, renderer="torch", groups=["normals"])},
        {"scene": sphere, **_held(steps // 4, renderer="pyrender", groups=["illumination"], method="zoo")},
        {"scene": sphere, **_held(steps // 4, **image, method="square")},
    ]


def requests(count: int, steps: int) -> list[dict[str, Any]]:
    """`count` requests, of each kind in turn."""
    kinds = mixed(steps)
    return [kinds[number % len(kinds)] for number in range(count)]


RUNNING = ("scene_attack_worker.job_process", "scene_attack_worker.rq_worker")
"""Processes that run jobs. They are hit while a job takes steps."""
OTHERS = ("redis-server", "supervisor", "scene_attack_api.main", "scene_attack_service.jobs.warm_process")
"""Other processes that can die: modules of the service, a program that it runs, and the supervisor, which is started
again."""
PATIENCE = 30.0
"""Time in seconds to wait for a process that is to be hit: it may have been hit just before."""


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


def hit(service: Service, database: Database, kind: str, target: str, draw: random.Random) -> bool:
    """Kills (SIGKILL) or stops (SIGSTOP) one of the target's processes. Returns whether there was one before long."""
    if target == DATABASE:
        database.stop(draw)
        return True
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        met = database.kill(target, draw) if target in database.killed else _send(service, kind, target, draw)
        if met:
            return True
        time.sleep(0.1)
    return False


def _send(service: Service, kind: str, target: str, draw: random.Random) -> bool:
    living = service.processes(target)
    if not living:
        return False
    try:
        draw.choice(living).send_signal(signal.SIGKILL if kind == "kill" else signal.SIGSTOP)
    except psutil.NoSuchProcess:
        return False
    return True


def keep_away(service: Service, database: Database, target: str, seconds: float) -> None:
    """Stops a program whenever it is started again, or the database, for `seconds`."""
    deadline = time.monotonic() + seconds
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
