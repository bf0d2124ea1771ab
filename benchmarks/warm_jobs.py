"""Runs many small jobs one after another through one worker of a service of its own. Measures the time from a request
to the beginning of its attack, and how the resident memory of worker and job process grows after the first jobs. Writes
results/warm_jobs.json.

Before its attack begins a job is checked, recorded, queued, taken and prepared: assets, renderer, plan, and the answer
to the unperturbed image. What a method measures before its first update is part of the attack; ZOO asks the network for
each coordinate.

A short run: python -m benchmarks.warm_jobs --jobs 100
The whole one: python -m benchmarks.warm_jobs --jobs 1000

The first ten jobs are not timed: they load what later ones find loaded. The machine should be idle. A worker replaces
its job process after 200 jobs; growth is that of the largest process since.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from benchmarks.chaos.client import ENDED, Client
from benchmarks.chaos.jobs import mixed
from benchmarks.chaos.service import Service
from benchmarks.report import RESULTS, save
from services.jobs.database import connect
from services.jobs.repository import Repository
from services.settings import Settings

COLD = 10
"""Jobs that are not timed."""
STEPS = 4
STAGES = ("queued", "running", "loading", "attack")
MODULES = ("worker.job_process", "worker.rq_worker", "api.main")


def main() -> None:
    """Runs the jobs; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=100, help="number of jobs (default 100)")
    parser.add_argument("--settle", type=int, default=50, help="jobs before memory is compared (default 50)")
    parser.add_argument("--out", type=Path, default=RESULTS / "warm_jobs.json")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="scene-attack-warm-") as folder:
        settings = Settings(data=Path(folder) / "data", workers=1)
        service = Service(settings, Path(folder) / "log", 60.0)
        client = Client(service.url, 300.0)
        try:
            found = _run(service, client, mixed(4 * STEPS), options.jobs, options.settle)
        finally:
            client.close()
            service.end()
    save(options.out, __doc__ or "", "SQLite", 0, cores=os.cpu_count(), **found)


def _run(service: Service, client: Client, kinds: list[dict[str, Any]], jobs: int, settle: int) -> dict[str, Any]:
    seconds: list[list[float]] = [[] for _ in kinds]
    stages: dict[str, list[float]] = {name: [] for name in STAGES}
    memory: dict[str, list[float]] = {module: [] for module in MODULES}
    repository: Repository | None = None
    for number in range(jobs):
        sent = time.time()
        job_id = client.submit(kinds[number % len(kinds)] | {"seed": number}, f"warm-{number}")
        repository = repository or Repository(connect(service.settings))
        while (found := client.job(job_id))["state"] not in ENDED:
            time.sleep(0.02)
        if found["state"] != "succeeded":
            raise RuntimeError(f"a job {found['state']}: {found['failure']}")
        if number >= COLD:
            moments = _moments(repository, job_id)
            seconds[number % len(kinds)].append(moments["attack"] - sent)
            for name, before in zip(STAGES, ("", *STAGES), strict=False):
                stages[name].append(moments[name] - (moments[before] if before else sent))
        for module in MODULES:
            memory[module].append(sum(one.memory_info().rss for one in service.processes(module)) / 2**20)
    return {
        "jobs": jobs,
        "milliseconds from request to attack": _spread([one for some in seconds for one in some]),
        "by kind of job": [
            {"attack": kind["attack"]} | _spread(some) for kind, some in zip(kinds, seconds, strict=True) if some
        ],
        "of these, median ms until": {name: round(1000 * median(all_), 1) for name, all_ in stages.items()},
        "resident MiB": {
            module: {
                f"after {settle}": round(sizes[min(settle, jobs) - 1]),
                "largest since": round(max(sizes[min(settle, jobs) - 1 :])),
                "growth": round(max(sizes[min(settle, jobs) - 1 :]) - sizes[min(settle, jobs) - 1], 1),
            }
            for module, sizes in memory.items()
        },
    }


def _spread(seconds: list[float]) -> dict[str, float]:
    """Median and 95th percentile, in milliseconds."""
    last = quantiles(seconds, n=20, method="inclusive")[-1] if len(seconds) > 1 else seconds[0]
    return {"median": round(1000 * median(seconds), 1), "95th percentile": round(1000 * last, 1)}


def _moments(repository: Repository, job_id: str) -> dict[str, float]:
    """The times (POSIX) at which a job came to each of the stages."""
    found: dict[str, float] = {}
    for event in repository.events(job_id, 0):
        at, rows = event.created_at.timestamp(), event.data.get("rows")
        if rows:
            found.setdefault("attack", at - rows[-1]["seconds"])
        found.setdefault(str(event.data.get("state") or event.data.get("phase")), at)
    return found


if __name__ == "__main__":
    main()
