"""How much two single-threaded workers get done in the time of one: the same load of jobs is run by a service with one
worker and by one with two, in turn. Prints the ratio of the times, which should be at least 1.7 on two cores or more.

A short run: python -m benchmarks.two_workers --jobs 12 --steps 40
The whole one: python -m benchmarks.two_workers

A load's time is from the beginning of its first job to the end of its last one, by the record. What comes before is not
in it: the workers have started and have each run jobs of every kind, and all jobs of the load were queued before. They
are written into the record, so that nothing else of the service is busy. The machine should be idle. Writes
results/two_workers.json; the exit code is 1 if the ratio is below 1.7.
"""

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.chaos.jobs import requests
from benchmarks.chaos.service import Service
from benchmarks.report import RESULTS, save
from services.jobs.database import connect, migrate
from services.jobs.models import Job, State
from services.jobs.repository import Repository
from services.pipeline.spec import parse
from services.settings import Settings

ENOUGH = 1.7
"""The ratio that two workers should reach."""
KINDS = 6
"""Kinds of jobs in a load."""
COLD = KINDS
"""Jobs of each worker before the load, whose first ones load what later ones find loaded."""
PATIENCE = 600.0
"""Longest time without the end of a job, in seconds."""


def main() -> int:
    """Runs the loads; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=120, help="jobs of a load, of six kinds in turn (default 120)")
    parser.add_argument("--steps", type=int, default=160, help="steps of the longest jobs (default 160)")
    parser.add_argument("--rounds", type=int, default=2, help="loads of each number of workers (default 2)")
    parser.add_argument("--out", type=Path, default=RESULTS / "two_workers.json")
    options = parser.parse_args()
    seconds: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(options.rounds):
        for workers, times in seconds.items():
            times.append(_load(workers, requests(options.jobs, options.steps), options.steps))
            print(f"{workers} worker{'s' if workers > 1 else ''}: {times[-1]:.1f} s", flush=True)
    ratio = min(seconds[1]) / min(seconds[2])
    print(f"two workers get {ratio:.2f} times as much done as one (wanted: {ENOUGH})")
    found = {"jobs": options.jobs, "steps": options.steps, "ratio": round(ratio, 3)}
    found |= {"seconds with one worker": seconds[1], "seconds with two": seconds[2]}
    save(options.out, __doc__ or "", "SQLite", 0, cores=os.cpu_count(), **found)
    return 0 if ratio >= ENOUGH else 1


def _load(workers: int, load: list[dict[str, Any]], steps: int) -> float:
    """The time in seconds that so many workers take for the load."""
    with tempfile.TemporaryDirectory(prefix="scene-attack-two-workers-") as folder:
        settings = Settings(data=Path(folder) / "data", workers=workers, threads=1)
        engine = connect(settings)
        migrate(engine, settings)
        repository = Repository(engine)
        service = Service(settings, Path(folder) / "log", 60.0)
        try:
            _run(repository, requests(workers * COLD, steps))
            return _run(repository, load)
        finally:
            service.end()
            engine.dispose()


def _run(repository: Repository, load: list[dict[str, Any]]) -> float:
    """Queues jobs and waits until all have ended. Returns the time from the first one's beginning until then."""
    ids = []
    for number, request in enumerate(load):
        job, _ = repository.create(parse(request | {"seed": number}), len(load) + 1, None, lambda job: {"id": job.id})
        assert job is not None
        ids.append(job.id)
    jobs: list[Job] = []
    ended = time.monotonic()
    while len(jobs) < len(ids):  # asked twice a second at most, to leave the processor to the workers
        job = repository.line(ids[len(jobs)])
        assert job is not None
        if job.state.terminal:
            jobs.append(job)
            ended = time.monotonic()
        elif time.monotonic() - ended > PATIENCE:
            raise TimeoutError(f"a job does not end; {len(jobs)} of {len(ids)} have")
        else:
            time.sleep(0.5)
    failed = [job for job in jobs if job.state is not State.SUCCEEDED]
    if failed:
        raise RuntimeError(f"{len(failed)} jobs did not succeed; the first one: {failed[0].failure_detail}")
    first = min(job.times[State.RUNNING] for job in jobs)
    return (max(job.times[State.SUCCEEDED] for job in jobs) - first).total_seconds()


if __name__ == "__main__":
    sys.exit(main())
