"""Kills (SIGKILL) and stops (SIGSTOP) the processes of a service at random while it runs mixed jobs: job process,
worker, API, check process, Redis, supervisor and database. Redis and the database are once away for longer than a job.
Then every job must have one result, none twice, none failed, and each must be the same to the byte as that of an
undisturbed run. Prints the counts as JSON, and writes them with the provenance of a result file if asked to.

PostgreSQL (--database postgresql) is a server of the run's own: the postmaster or the process of a connection is
killed, or all its processes are stopped, and the server is started again. SQLite is a file: its lock is held instead.

The whole load: python -m benchmarks.chaos --jobs 300 --workers 3 --kills 60 --stops 10
The short form: python -m benchmarks.chaos --jobs 6 --workers 1 --kills 6 --stops 2 --steps 40 --stall 8 --watchdog 12
"""

import argparse
import json
import os
import sys
from pathlib import Path

from benchmarks.chaos.load import Load, run
from benchmarks.report import save


def main() -> int:
    """Runs the load of the command line. Returns 0 if every job came out as undisturbed, else 1."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.chaos", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=300, help="number of jobs (default 300)")
    parser.add_argument("--workers", type=int, default=3, help="number of workers (default 3)")
    parser.add_argument("--kills", type=int, default=60, help="number of processes to kill (default 60)")
    parser.add_argument("--stops", type=int, default=10, help="number of processes to stop (default 10)")
    parser.add_argument("--steps", type=int, default=120, help="steps of the longest jobs (default 120)")
    parser.add_argument("--seed", type=int, default=0, help="of the order and the moments of the faults (default 0)")
    parser.add_argument("--stall", type=float, default=40.0, help="SCENE_ATTACK_STALL_SECONDS (default 40)")
    parser.add_argument(
        "--watchdog", type=float, default=60.0, help="silence in seconds after which the service is started again"
    )
    parser.add_argument("--pause", type=float, default=4.0, help="longest time between two faults, in seconds")
    parser.add_argument(
        "--patience", type=float, default=900.0, help="longest time without a job that ends, in seconds"
    )
    parser.add_argument("--database", choices=("sqlite", "postgresql"), default="sqlite", help="default: sqlite")
    parser.add_argument("--no-away", dest="away", action="store_false", help="keep neither Redis nor database away")
    parser.add_argument("--out", type=Path, help="file to write the counts to, e.g. benchmarks/results/chaos.json")
    parser.add_argument("--log", type=Path, help="file for the log of the service; default: it is not kept")
    options = vars(parser.parse_args())
    out = options.pop("out")
    result = run(Load(**options))
    print(json.dumps(result, indent=1))
    if out is not None:
        assert __doc__ is not None
        save(out, __doc__, result.pop("backend"), options["seed"], cores=os.cpu_count(), **result)
    return 0 if result["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
