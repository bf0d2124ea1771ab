"""`scene-attack worker`: supervises the worker processes and maintains the record."""

import secrets
import socket
import sys
from collections.abc import Callable

from redis.exceptions import RedisError
from sqlalchemy.exc import SQLAlchemyError

from scene_attack.logs import configure, logger
from scene_attack.process import check_device, program
from scene_attack.runs.set_up import set_up
from scene_attack_service.jobs.campaigns import Feeder
from scene_attack_service.jobs.database import connect as connect_database
from scene_attack_service.jobs.database import migrate
from scene_attack_service.jobs.files import Housekeeping
from scene_attack_service.jobs.queue import Queue, reconcile
from scene_attack_service.jobs.queue import connect as connect_redis
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings
from scene_attack_worker.supervisor import Program, Supervisor

QUEUED_OF_CAMPAIGNS = 8
"""Queued jobs of all campaigns together, or as many as there are workers. A job sent alone waits behind few."""

log = logger(__name__)


def run(values: Settings) -> int:
    """Supervises the workers until SIGTERM or SIGINT. Returns the exit status.

    Raises InvalidRequest if the device of the settings is not there, or the URL of Redis is missing or none.
    """
    set_up(values)  # the supervisor reads campaigns, whose fields may be a plug-in's
    check_device()
    configure("worker-supervisor")
    connect_redis(values.redis_url).close()  # refuses a URL that cannot be, before anything is made
    engine = connect_database(values)
    migrate(engine, values)
    record = Record(engine)
    Supervisor(workers(values, record), housekeeping(values, record)).run()
    return 0


def workers(values: Settings, record: Record) -> list[Program]:
    """The worker programs, as many as the settings say."""
    return [_worker(index, values, record) for index in range(values.workers)]


def _worker(index: int, values: Settings, record: Record) -> Program:
    # Each start has a new name, so that a lease under an earlier name is known to be a dead worker's.
    name = ""

    def command() -> list[str]:
        nonlocal name
        name = f"{socket.gethostname()[:60]}-{index}-{secrets.token_hex(4)}"
        return program("scene_attack_worker.rq_worker", name)

    def ended() -> None:
        try:
            lost = record.leases.take_back(owner=name)
        except SQLAlchemyError as error:
            log.warning("jobs of a dead worker not taken back yet", error=str(error))
        else:
            for job_id in lost:
                log.warning("job taken back from a dead worker", job=job_id, worker=name)

    silent = values.stall_seconds
    return Program(f"worker-{index}", command, values.environ(), ended=ended, silent_seconds=silent)


def housekeeping(values: Settings, record: Record) -> Callable[[], None]:
    """Returns the function that a supervisor calls once a second. It takes lapsed leases back, moves campaigns on,
    rings for queued jobs, and removes what nothing needs any more.

    Several supervisors may do so at once; each step is a transaction that changes a job at most once.
    """
    queue = Queue(connect_redis(values.redis_url))
    feeder = Feeder(record.database, max(QUEUED_OF_CAMPAIGNS, values.workers))
    house = Housekeeping(record, values)
    failing = False

    def tick() -> None:
        nonlocal failing
        try:
            for job_id in record.leases.take_back():
                log.warning("job taken back, its lease had lapsed", job=job_id)
            feeder.tick()
            reconcile(record.scheduler, queue)
            house.tidy()
        except (SQLAlchemyError, RedisError, OSError) as error:
            if not failing:  # once, or an outage would fill the log
                log.warning("housekeeping put off", error=str(error))
            failing = True
        else:
            failing = False

    return tick


if __name__ == "__main__":
    sys.exit(run(Settings()))
