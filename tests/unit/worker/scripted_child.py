"""A job process for the tests of the runner: it renders nothing, and does what the seed of a job's request says."""

import os
import signal

from services.jobs.child import connect, reply, requests
from services.jobs.database import connect as connect_database
from services.jobs.placement import Abilities
from services.jobs.repository import Repository
from services.pipeline.spec import DEFAULT_TARGET
from services.settings import settings

ANSWERS, DIES, HANGS, MEETS_AN_OUTAGE = range(4)

if __name__ == "__main__":
    connection = connect()
    repository = Repository(connect_database(settings()))
    abilities = Abilities(targets=frozenset({DEFAULT_TARGET}), memory=7)
    reply(connection, {"ready": os.getpid(), "abilities": abilities.record()})
    for message, _ in requests(connection):
        job = repository.work(message["job"])
        seed = HANGS if job is None else job.seed
        if seed == DIES:
            os.kill(os.getpid(), signal.SIGKILL)
        if seed == HANGS:
            signal.pause()
        reply(connection, {"outage": "the disk is full"} if seed == MEETS_AN_OUTAGE else {"done": message["job"]})
