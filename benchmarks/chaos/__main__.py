"""Kills (SIGKILL) and stops (SIGSTOP) the processes of a service at random while it runs mixed jobs: job process,
worker, API, check process, Redis and supervisor; Redis is once away for longer than a job. Then every job must have one
result, none twice, none failed, and each must be the same to the byte as that of an undisturbed run. Prints the counts
as JSON.

The whole load: python -m benchmarks.chaos --jobs 300 --workers 3 --kills 60 --stops 10
The short form: python -m benchmarks.chaos --jobs 6 --kills 6 --stops 2 --steps 60 --stall 4 --watchdog 8
"""

import argparse
import json
import sys

from benchmarks.chaos.load import Load, run


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
    parser.add_argument("--database-url", help="a PostgreSQL to use instead of SQLite; its database must be empty")
    parser.add_argument("--redis-stays", dest="away", action="store_false", help="do not keep Redis away")
    found = run(Load(**vars(parser.parse_args())))
    print(json.dumps(found, indent=1))
    return 0 if found["ok"] else 1


if __name__ == "__main__":
    sys.exit(main())
