"""The time of each operation on the record that a job's way through the service is made of, with SQLite and with
a PostgreSQL of the benchmark's own; and what a service with one worker asks of PostgreSQL while it is idle and while a
job runs. Writes results/record.json.

Operations: one connection, one job at a time, beside jobs that stay queued; times are medians, by the clock.
PostgreSQL has its default settings. Transactions are counted by PostgreSQL, reads and writes alike.
"""

import argparse
import os
import sqlite3
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import psycopg

from benchmarks.chaos.client import Client
from benchmarks.chaos.jobs import mixed
from benchmarks.chaos.service import Service
from benchmarks.postgresql import Server
from benchmarks.report import RESULTS, save
from services.jobs.database import connect, migrate
from services.jobs.models import Job
from services.jobs.placement import Abilities
from services.jobs.repository import Repository
from services.pipeline.spec import parse
from services.settings import Settings

LONG = 10_000
"""Steps of a job that runs for minutes."""
T = TypeVar("T")
ROW = {"step": 1, "queries": 2, "seconds": 0.1, "loss": 0.9, "label": "teapot", "confidence": 0.9, "advantage": 3.0}
OUTCOME = {"fooled": True, "steps": 1, "queries": 2, "p": 0.004}
WORKER = "benchmark"
ABLE = Abilities("cpu", frozenset({"efficientnet-lite0"}), 2**34)


def main() -> None:
    """Runs the operations; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=300, help="jobs that are run through (default 300)")
    parser.add_argument("--queued", type=int, default=1000, help="jobs that stay queued (default 1000)")
    parser.add_argument("--seconds", type=float, default=20.0, help="how long to count transactions (default 20)")
    parser.add_argument("--out", type=Path, default=RESULTS / "record.json")
    options = parser.parse_args()
    found: dict[str, Any] = {"cores": os.cpu_count(), "load average": os.getloadavg()[0]}
    found |= {"jobs": options.jobs, "queued": options.queued}
    with tempfile.TemporaryDirectory(prefix="scene-attack-record-") as folder:
        found["milliseconds with SQLite"] = _operations(Settings(data=Path(folder)), options.jobs, options.queued)
        server = Server({})
        try:
            server.start()
            server.wait()
            settings = Settings(data=Path(folder), database_url=server.url(server.create()))
            found["milliseconds with PostgreSQL"] = _operations(settings, options.jobs, options.queued)
            settings = Settings(data=Path(folder) / "data", database_url=server.url(server.create()))
            found["asked of PostgreSQL"] = _asked(settings, Path(folder) / "log", options.seconds)
            backend = f"SQLite {sqlite3.sqlite_version}, PostgreSQL {server.version()}"
        finally:
            server.stop()
    save(options.out, __doc__ or "", backend, 0, **found)


def _operations(settings: Settings, jobs: int, queued: int) -> dict[str, float]:
    engine = connect(settings)
    try:
        migrate(engine, settings)
        return _run(Repository(engine), jobs, queued)
    finally:
        engine.dispose()


def _asked(settings: Settings, log: Path, seconds: float) -> dict[str, dict[str, float]]:
    """Transactions a second and connections of a service, idle and while a job runs."""
    service = Service(settings, log, 60.0)
    client = Client(service.url, 120.0)
    try:
        job = client.submit(mixed(LONG)[1], "warm")
        _until(client, job, lambda found: (found["progress"] or {}).get("step", 0) > 0)
        busy = _counted(settings, seconds)
        steps = client.job(job)["progress"]["step"]
        client.cancel(job)
        _until(client, job, lambda found: found["state"] == "cancelled")
        return {"idle": _counted(settings, seconds), "busy": busy | {"steps by then": steps}}
    finally:
        client.close()
        service.end()


def _until(client: Client, job: str, met: Callable[[dict[str, Any]], bool]) -> None:
    while not met(client.job(job)):
        time.sleep(0.1)


def _counted(settings: Settings, seconds: float) -> dict[str, float]:
    assert settings.database_url is not None
    count = "SELECT xact_commit + xact_rollback, numbackends FROM pg_stat_database WHERE datname = current_database()"
    with psycopg.connect(settings.database_url, autocommit=True) as connection:
        time.sleep(2)  # PostgreSQL counts a transaction up to a second late
        [before] = connection.execute(count).fetchall()
        time.sleep(seconds)
        [after] = connection.execute(count).fetchall()
    return {"transactions a second": round((after[0] - before[0]) / seconds, 1), "connections": after[1] - 1}


def _run(repository: Repository, jobs: int, queued: int) -> dict[str, float]:
    seconds: dict[str, list[float]] = {}

    def timed(name: str, operation: Callable[[], T]) -> T:
        began = time.perf_counter()
        result = operation()
        seconds.setdefault(name, []).append(time.perf_counter() - began)
        return result

    for number in range(queued + jobs):
        job = timed("submission", partial(_submit, repository, number))
        if number < queued:
            seconds.clear()
            continue
        timed("turn", partial(repository.turn, job.id, ABLE))
        attempt = timed("lease", partial(repository.lease, job.id, WORKER, 60.0))
        assert attempt is not None
        timed("progress", partial(repository.progress, attempt, "attacking", 1, 9, [ROW]))
        timed("read of the standing", partial(repository.standing, attempt))
        timed("renewal", partial(repository.renew, attempt, 60.0))
        timed("result", partial(repository.succeed, attempt, {"rows": [ROW]}, OUTCOME, []))
    return {name: round(1000 * median(some), 2) for name, some in seconds.items()}


def _submit(repository: Repository, number: int) -> Job:
    job, _ = repository.create(parse(mixed(4)[0] | {"seed": number}), 10**6, None, lambda _: {})
    assert job is not None
    return job


if __name__ == "__main__":
    main()
