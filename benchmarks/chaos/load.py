"""One run: jobs are submitted while their service is hit, and every one is compared with an undisturbed one."""

import json
import random
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.sql.elements import ColumnElement

from benchmarks.chaos.client import Client, differences
from benchmarks.chaos.faults import PATIENCE, RUNNING, Fault, hit, keep_away, plan
from benchmarks.chaos.jobs import mixed, requests
from benchmarks.chaos.recovery import gaps, recovery
from benchmarks.chaos.service import Service
from services.jobs.database import connect
from services.jobs.models import Job, JobKind, State
from services.jobs.repository import Repository
from services.settings import Settings

AHEAD = 3
"""Jobs that wait or run at a time, for each worker."""


@dataclass(frozen=True)
class Load:
    """What a run does. Times in seconds; `stall` and `watchdog` are those after which what hangs is killed."""

    jobs: int
    workers: int
    kills: int
    stops: int
    steps: int = 120
    seed: int = 0
    stall: float = 40.0
    watchdog: float = 60.0
    away: bool = True
    """Whether Redis is once away for longer than the longest job takes."""
    pause: float = 4.0
    """Longest time between two faults that are due."""
    patience: float = 900.0
    """Time without any job ending after which the run has failed."""
    database_url: str | None = None


def run(load: Load) -> dict[str, Any]:
    """Runs the load and returns its counts. "ok" is whether every job has one result, the same as undisturbed."""
    with tempfile.TemporaryDirectory(prefix="scene-attack-chaos-") as folder, _served(load, Path(folder)) as service:
        client = Client(service.url, load.patience)
        engine = connect(service.settings)
        try:
            return _run(load, service, client, engine)
        finally:
            client.close()
            engine.dispose()


def _run(load: Load, service: Service, client: Client, engine: Engine) -> dict[str, Any]:
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
    faults, missed = _hit_all(load, service, engine, known, longest)
    sender.join(load.patience)
    _until(load, lambda: _ended(engine) - known >= load.jobs, engine)
    seconds = time.monotonic() - began
    return _counts(load, client, Repository(engine), ids, undisturbed) | {
        "seconds": round(seconds, 1),
        "starts of the service": service.starts,
        "faults": dict(sorted(Counter(f"{fault.kind} {fault.target}" for fault in faults).items())),
        "faults that met no process": missed,
        "refused or broken requests": dict(client.errors),
        "recovery": recovery(_all_gaps(Repository(engine), ids), faults),
    }


@contextmanager
def _served(load: Load, folder: Path) -> Iterator[Service]:
    settings = Settings(
        data=folder / "data",
        database_url=load.database_url,
        workers=load.workers,
        threads=1,
        stall_seconds=load.stall,
        max_queued=max(1000, 2 * load.jobs),
    )
    service = Service(settings, folder / "log", load.watchdog)
    try:
        yield service
    except BaseException:
        print((folder / "log").read_text()[-20_000:])
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
        longest = max(longest, float(job["result"]["seconds"]))
    return [client.files(job_id) for job_id in ids], longest


def _hit_all(load: Load, service: Service, engine: Engine, known: int, longest: float) -> tuple[list[Fault], int]:
    """Hits the service until all faults are done, spread evenly over the jobs."""
    draw = random.Random(load.seed)
    done: list[Fault] = []
    missed = 0
    planned = plan(load.kills, load.stops, load.seed)
    for number, (kind, target) in enumerate(planned):
        due = known + number * load.jobs // (len(planned) + 1)
        _until(load, lambda due=due: _ended(engine) >= due, engine)  # type: ignore[misc]
        time.sleep(draw.uniform(0.1, load.pause))
        if load.away and number == len(planned) // 2:
            done.append(keep_away(service, "redis-server", 1.5 * longest, lambda: False))
        if target in RUNNING:
            _wait_for_a_step(engine)
        fault = hit(service, kind, target, draw)
        if fault is None:
            missed += 1
        else:
            done.append(fault)
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
    """Waits until a job takes steps, so that a fault of what runs jobs meets one; not for long if there is none."""
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


def _counts(
    load: Load, client: Client, repository: Repository, ids: list[str], undisturbed: list[dict[str, str]]
) -> dict[str, Any]:
    states: Counter[str] = Counter()
    failures: Counter[str] = Counter()
    attempts: Counter[str] = Counter()
    different: list[dict[str, Any]] = []
    identical = results = 0
    for number, job_id in enumerate(ids):
        job = client.job(job_id)
        states[job["state"]] += 1
        attempts[str(job["attempt"])] += 1
        if job["failure"] is not None:
            failures[job["failure"]["kind"]] += 1
        ends = [event for event in repository.events(job_id, 0, limit=10**6) if event.data.get("state") == "succeeded"]
        results += len(ends)
        if job["state"] == "succeeded":
            said = _differences(client.files(job_id), undisturbed[number % len(undisturbed)])
            identical += not said
            if said:
                different.append({"kind": number % len(undisturbed), "attempts": job["attempt"], "differences": said})
    recorded = _recorded(repository)
    wanted = load.jobs + len(undisturbed)
    return {
        "ok": len(set(ids)) == identical == results == load.jobs and recorded == wanted,
        "jobs": load.jobs,
        "states": dict(states),
        "failures": dict(failures),
        "identical to an undisturbed run": identical,
        "different": different,
        "results": results,
        "jobs that nobody submitted": recorded - wanted,
        "attempts": dict(sorted(attempts.items())),
    }


def _differences(found: dict[str, str], wanted: dict[str, str]) -> list[str]:
    """Where a job's files differ from those of an undisturbed one, at most ten places of each file."""
    said = []
    for name in sorted(found.keys() | wanted.keys()):
        if name.endswith(".json") and name in found and name in wanted:
            said += differences(json.loads(found[name]), json.loads(wanted[name]), name)[:10]
        elif found.get(name) != wanted.get(name):
            said.append(name)
    return said


def _recorded(repository: Repository) -> int:
    with repository._read() as session:  # noqa: SLF001 - the service has no use for it
        return session.scalar(select(func.count()).select_from(Job).where(Job.kind == JobKind.ATTACK)) or 0


def _all_gaps(repository: Repository, ids: list[str]) -> list[Any]:
    return [gap for job_id in ids for gap in gaps(repository.events(job_id, 0, limit=10**6))]
