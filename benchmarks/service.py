"""Measures a service of its own. The first argument says what; `--count` is the number of what its text counts.

start        Time from the request of a small job to its attack's beginning, for COUNT jobs one after another through
             one worker, and the resident memory of its processes. The first ten jobs are not timed. A worker replaces
             its job process after 200 jobs.
record       Each operation on the record on the way of COUNT jobs through the service, beside 1,000 queued ones, with
             SQLite and with a PostgreSQL of its own; and what a service with one worker asks of PostgreSQL in SECONDS
             while it is idle and while a job runs. Transactions are counted by PostgreSQL, reads and writes alike.
workers      COUNT jobs by one worker and by two, in turn, from the beginning of the first to the end of the last by the
             record. The workers have run jobs of each kind before. Ends with 1 if two get less than 1.7 times as much
             done as one.
list         Pages of the list with COUNT jobs in the record, and the page of one that was run; bytes are compressed.

Times are medians where nothing else is said. The machine should be idle; the client takes its share of it. Results are
written to results/service_WHAT.json. A short run: python -m benchmarks.service start --count 30
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median, quantiles
from typing import Any, TypeVar

import httpx
import psycopg

from benchmarks.chaos.counts import ENDED, Client
from benchmarks.chaos.load import mixed, requests
from benchmarks.chaos.service import Service
from benchmarks.filled_record import fill
from benchmarks.postgresql import Server
from benchmarks.report import RESULTS, save
from scene_attack.client.states import Priority
from scene_attack.runs.spec import parse
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.jobs.models import State
from scene_attack_service.jobs.queue import Abilities
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings

COLD = 10
"""Jobs of a new service that are not timed: they load the data and modules of later ones."""
LONG = 10_000
"""Steps of a job that runs for minutes."""
QUEUED = 1000
"""Jobs that stay queued beside those whose operations are timed."""
ENOUGH = 1.7
"""Ratio that two workers should reach."""
MODULES = ("scene_attack_worker.job_process", "scene_attack_worker.rq_worker", "scene_attack_api.main")
PAGES = {
    "newest first": "/",
    "sorted by p": "/?sort=p",
    "a query, sorted": "/?q=scene:piano renderer:torch verified p<5e-3&sort=-queries",
    "a query of words": "/?q=piano -state:failed",
    "a query that nothing meets": "/?q=tag:none",
}
ROW = {"step": 1, "queries": 2, "seconds": 0.1, "loss": 0.9, "label": "teapot", "confidence": 0.9, "advantage": 3.0}
ABILITIES = Abilities("cpu", frozenset({"efficientnet-lite0"}), 2**34)
T = TypeVar("T")


def main() -> int:
    """Measures; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=list(MEASUREMENTS))
    parser.add_argument("--count", type=int, help="see above (default: " + _counts() + ")")
    parser.add_argument("--seconds", type=float, default=20.0, help="how long record lasts (default 20)")
    parser.add_argument("--out", type=Path, help="file of the result")
    options = parser.parse_args()
    measure, count = MEASUREMENTS[options.what]
    load = os.getloadavg()[0]
    result = measure(options.count or count, options.seconds)
    out = options.out or RESULTS / f"service_{options.what}.json"
    save(out, __doc__ or "", "SQLite", 0, cores=os.cpu_count(), **{"load average before": load}, **result)
    return int(result.get("ratio", ENOUGH) < ENOUGH)


def start(count: int, _seconds: float) -> dict[str, Any]:
    """Milliseconds to the beginning of an attack, by stage and by kind of job, and resident memory."""
    stages: dict[str, list[float]] = {name: [] for name in ("queued", "running", "loading", "attack", "all")}
    kinds = mixed(16)
    by_kind: list[list[float]] = [[] for _ in kinds]
    memory: dict[str, list[float]] = {module: [] for module in MODULES}
    record: Record | None = None
    with _served(workers=1) as (service, client):
        for number in range(COLD + count):
            sent = time.time()
            job_id = client.submit(kinds[number % len(kinds)] | {"seed": number}, f"start-{number}")
            _until(client, job_id, _has_ended)
            record = record or Record(connect(service.settings))  # which the service has created by now
            for module, sizes in memory.items():
                sizes.append(_mebibytes(service, module))
            if number < COLD:
                continue
            moments = _moments(record, job_id) | {"": sent}
            for name, before in zip(stages, ("", "queued", "running", "loading"), strict=False):
                stages[name].append(moments[name] - moments[before])
            stages["all"].append(moments["attack"] - sent)
            by_kind[number % len(kinds)].append(moments["attack"] - sent)
    return {
        "jobs": count,
        "milliseconds by stage": {name: _spread(seconds) for name, seconds in stages.items()},
        "by kind of job": [
            {"attack": kind["attack"]} | _spread(some) for kind, some in zip(kinds, by_kind, strict=True) if some
        ],
        "resident MiB": {
            module: {f"after {COLD}": round(sizes[COLD - 1]), "largest since": round(max(sizes[COLD:]))}
            for module, sizes in memory.items()
        },
    }


def record(count: int, seconds: float) -> dict[str, Any]:
    """Milliseconds of each operation on the record, with both databases; transactions a second and connections."""
    with tempfile.TemporaryDirectory(prefix="scene-attack-record-") as folder:
        result: dict[str, Any] = {"milliseconds with SQLite": _operations(Settings(data=Path(folder)), count)}
    server = Server({})
    try:
        server.start()
        server.wait()
        with tempfile.TemporaryDirectory(prefix="scene-attack-record-") as folder:
            settings = Settings(data=Path(folder), database_url=server.url(server.create()))
            result["milliseconds with PostgreSQL"] = _operations(settings, count)
        url = server.url(server.create())
        with _served(database_url=url) as (_, client):
            [job_id] = _busy(client, 1)
            busy = _transactions(url, seconds)
            client.cancel(job_id)
            _until(client, job_id, lambda job: job["state"] == "cancelled")
            result["asked of PostgreSQL"] = {"idle": _transactions(url, seconds), "busy": busy}
        return result | {"PostgreSQL": server.version(), "jobs": count, "queued": QUEUED}
    finally:
        server.stop()


def workers(count: int, _seconds: float) -> dict[str, Any]:
    """Seconds of the same jobs with one worker and with two, each the shorter of two rounds, and their ratio."""
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for number in (1, 2, 1, 2):
        with _served(workers=number) as (service, client):
            record = Record(connect(service.settings))
            for cold in range(COLD * number):
                _until(client, client.submit(mixed(4)[cold % 6], f"cold-{cold}"), _has_ended)
            ids = [_create(record, request | {"seed": k}) for k, request in enumerate(requests(count, 160))]
            for job_id in ids:
                _until(client, job_id, _has_ended, pause=0.5)  # seldom, to leave the processor to the workers
            jobs = [job for job_id in ids if (job := record.jobs.line(job_id)) is not None]
            first, last = (
                min(job.times[State.RUNNING] for job in jobs),
                max(job.times[State.SUCCEEDED] for job in jobs),
            )
        seconds[number].append((last - first).total_seconds())
        print(f"{number} of the workers: {seconds[number][-1]:.1f} s", flush=True)
    ratio = min(seconds[1]) / min(seconds[2])
    return {"jobs": count, "ratio": round(ratio, 3), "seconds with one": seconds[1], "seconds with two": seconds[2]}


def job_list(count: int, _seconds: float) -> dict[str, Any]:
    """Milliseconds and compressed kilobytes of pages."""
    with _served(workers=1) as (service, client):
        job_id = client.submit(mixed(4)[0], "page")
        _until(client, job_id, _has_ended)
        fill(service.settings, count, rows=300)
        with httpx.Client(base_url=service.url, timeout=300, trust_env=False) as http:
            pages = {name: _page(http, path) for name, path in (PAGES | {"a job": f"/jobs/{job_id}"}).items()}
        size = sum(file.stat().st_size for file in service.settings.data.glob("jobs.sqlite*"))
    return {"jobs": count, "bytes of the database": size, "pages": pages}


MEASUREMENTS: dict[str, tuple[Callable[[int, float], dict[str, Any]], int]] = {
    "start": (start, 90),
    "record": (record, 300),
    "workers": (workers, 120),
    "list": (job_list, 10_000),
}
"""The measurements by name, each with its default count."""


def _counts() -> str:
    return ", ".join(f"{name} {count}" for name, (_, count) in MEASUREMENTS.items())


@contextmanager
def _served(**settings: Any) -> Iterator[tuple[Service, Client]]:
    """A service whose workers have one thread each, and a client that waits until it answers."""
    os.sync()  # what was written before is no part of what follows
    with tempfile.TemporaryDirectory(prefix="scene-attack-bench-") as folder:
        values = Settings(data=Path(folder) / "data", threads=1, **settings)
        service = Service(values, Path(folder) / "log", 60.0)
        client = Client(service.url, 300.0)
        try:
            yield service, client
        finally:
            client.close()
            service.end()


def _busy(client: Client, count: int) -> list[str]:
    """Submits jobs that do not end, and returns their ids once all take steps."""
    ids = [client.submit(mixed(LONG)[1] | {"seed": number}, f"busy-{number}") for number in range(count)]
    for job_id in ids:
        _until(client, job_id, lambda job: (job["progress"] or {}).get("step", 0) > 0)
    return ids


def _has_ended(job: dict[str, Any]) -> bool:
    """Whether a job has succeeded. Raises RuntimeError if it has ended otherwise."""
    if job["state"] in ENDED and job["state"] != "succeeded":
        raise RuntimeError(f"a job {job['state']}: {job['failure']}")
    return bool(job["state"] == "succeeded")


def _until(client: Client, job_id: str, met: Callable[[dict[str, Any]], bool], pause: float = 0.02) -> None:
    while not met(client.job(job_id)):
        time.sleep(pause)


def _moments(record: Record, job_id: str) -> dict[str, float]:
    """The times (POSIX) at which a job came to each of the stages."""
    moments: dict[str, float] = {}
    for event in record.jobs.events(job_id, 0):
        at, rows = event.created_at.timestamp(), event.data.get("rows")
        if rows:
            moments.setdefault("attack", at - rows[-1]["seconds"])
        moments.setdefault(str(event.data.get("state") or event.data.get("phase")), at)
    return moments


def _operations(settings: Settings, count: int) -> dict[str, float]:
    """Milliseconds of each operation on the record, through one connection."""
    engine = connect(settings)
    migrate(engine, settings)
    record = Record(engine)
    seconds: dict[str, list[float]] = {}

    def timed(name: str, operation: Callable[[], T]) -> T:
        began = time.perf_counter()
        result = operation()
        seconds.setdefault(name, []).append(time.perf_counter() - began)
        return result

    for number in range(QUEUED):
        _create(record, mixed(4)[0] | {"seed": number})
    for number in range(QUEUED, QUEUED + count):
        job_id = timed("submission", partial(_create, record, mixed(4)[0] | {"seed": number}))
        timed("turn", partial(record.scheduler.next_job, Priority.NORMAL, ABILITIES))
        attempt = timed("lease", partial(record.leases.lease, job_id, "benchmark", 60.0))
        assert attempt is not None
        timed("progress", partial(record.leases.progress, attempt, "attacking", 1, 9, [ROW]))
        timed("read of the standing", partial(record.leases.standing, attempt))
        timed("renewal", partial(record.leases.renew, attempt, 60.0))
        outcome = {"outcome": "held", "verified": False, "float_perceptibility": 0.004, "steps": 1, "queries": 2}
        timed("result", partial(record.leases.succeed, attempt, {"rows": [ROW]}, outcome | {"seconds": 0.1}, []))
    engine.dispose()
    return {name: round(1000 * median(some), 2) for name, some in seconds.items()}


def _create(record: Record, request: dict[str, Any]) -> str:
    """Writes a job into the record, so that nothing else of a service is busy."""
    job, _ = record.jobs.create(parse(request), 10**6, None, lambda _: {})
    assert job is not None
    return job.id


def _transactions(url: str, seconds: float) -> dict[str, float]:
    count = "SELECT xact_commit + xact_rollback, numbackends FROM pg_stat_database WHERE datname = current_database()"
    with psycopg.connect(url, autocommit=True) as connection:
        time.sleep(2)  # PostgreSQL counts a transaction up to a second late
        [before] = connection.execute(count).fetchall()
        time.sleep(seconds)
        [after] = connection.execute(count).fetchall()
    return {"transactions a second": round((after[0] - before[0]) / seconds, 1), "connections": after[1] - 1}


def _page(http: httpx.Client, path: str) -> dict[str, float]:
    seconds, size = [], 0
    for _ in range(15):
        began = time.perf_counter()
        with http.stream("GET", path, headers={"accept-encoding": "gzip"}) as answer:
            size = sum(map(len, answer.iter_raw()))
        seconds.append(time.perf_counter() - began)
        answer.raise_for_status()
    return {"milliseconds": round(1000 * median(seconds), 1), "kilobytes": round(size / 1000, 1)}


def _mebibytes(service: Service, module: str) -> float:
    return float(sum(process.memory_info().rss for process in service.processes(module)) / 2**20)


def _spread(seconds: list[float]) -> dict[str, float]:
    """Median, 95th and 99th percentile and largest, in milliseconds."""
    cuts = quantiles(seconds, n=100, method="inclusive") if len(seconds) > 1 else 99 * seconds
    values = {"median": median(seconds), "95 %": cuts[94], "99 %": cuts[98], "largest": max(seconds)}
    return {name: round(1000 * value, 1) for name, value in values.items()}


if __name__ == "__main__":
    sys.exit(main())
