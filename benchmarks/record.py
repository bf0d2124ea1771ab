"""The time of each operation on the record of jobs that a job's way through the service is made of. Writes
results/record.json.

One connection, one job at a time, beside jobs that stay queued; times are medians, by the clock. With PostgreSQL the
server's settings are its own.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import TypeVar

from benchmarks.chaos.jobs import mixed
from benchmarks.report import RESULTS, save
from services.jobs.database import connect, migrate
from services.jobs.models import Job
from services.jobs.placement import Abilities
from services.jobs.repository import Repository
from services.pipeline.spec import parse
from services.settings import Settings

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
    parser.add_argument("--database-url", help="a PostgreSQL to use instead of SQLite; its database must be empty")
    parser.add_argument("--out", type=Path, default=RESULTS / "record.json")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="scene-attack-record-") as folder:
        settings = Settings(data=Path(folder), database_url=options.database_url)
        engine = connect(settings)
        migrate(engine, settings)
        found = _run(Repository(engine), options.jobs, options.queued)
        backend = f"{engine.dialect.name} {engine.driver}"
        engine.dispose()
    circumstances = {"cores": os.cpu_count(), "load average": os.getloadavg()[0]}
    save(options.out, __doc__ or "", backend, 0, **circumstances, jobs=options.jobs, queued=options.queued, ms=found)


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
