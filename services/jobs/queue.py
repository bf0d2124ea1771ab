"""The queue: RQ on Redis carries job ids to workers. If Redis loses them, they are sent again from the record.

RQ is transport and no more: no function that a message names is imported or called. Whoever can write to Redis can
start a job that is queued, at most. Whether the job may run, and what it is, a worker reads from the record.
"""

import re
from contextlib import suppress
from dataclasses import dataclass

import rq
from redis import Redis
from rq.exceptions import DeserializationError, DuplicateJobError
from rq.job import Job as Message

from services.jobs.repository import Repository, Waiting

NAME = "scene-attack"
TASK = "run_job"
"""What a message asks for. No function has this name."""
HEARTBEAT_SECONDS = 5
"""Longest time between two heartbeats of a worker."""
ANSWER_SECONDS = 3
"""Time after which Redis is taken to be away."""
_SIGN = f"{NAME}:worker:"
_ID = re.compile(r"[0-9a-f]{32}")
SETTLE_SECONDS = 5.0
"""Age below which a missing message is not sent again: a worker may have taken it and not leased its job yet."""


def connect(url: str) -> Redis:
    """Returns a Redis client that gives up after 3 seconds without an answer.

    The URL begins with redis:, rediss: (TLS) or unix:, and may have a user and a password. Over TLS the server's
    certificate must be one that this machine trusts, or one of the file `?ssl_ca_certs=`.
    """
    return Redis.from_url(url, socket_timeout=ANSWER_SECONDS, socket_connect_timeout=ANSWER_SECONDS)


def job_id_of(message: Message) -> str | None:
    """The id of the job that a message is about; None if `Queue.send` did not make it."""
    try:
        asked, arguments, named = message.func_name, message.args, message.kwargs
    except (DeserializationError, TypeError, ValueError):
        return None
    if asked != TASK or named or len(arguments) != 1 or not isinstance(arguments[0], str):
        return None
    return arguments[0] if _ID.fullmatch(arguments[0]) else None


@dataclass(frozen=True)
class Queue:
    """The queue of messages, each of which stands for a queued job and the number of attempts it has had."""

    redis: Redis

    def _queue(self) -> rq.Queue:
        return rq.Queue(NAME, connection=self.redis, serializer="json")

    def send(self, job_id: str, attempt: int) -> None:
        """Puts a job's id on the queue, once. `attempt` is the number of attempts it has had. Raises RedisError."""
        with suppress(DuplicateJobError):
            self._queue().enqueue_call(
                TASK,
                args=(job_id,),
                job_id=_message_id(job_id, attempt),
                unique=True,
                timeout=-1,  # limits are the worker's own
                result_ttl=0,
                description=job_id,
            )

    def waiting(self) -> set[str]:
        """Ids of the messages on the queue. Raises RedisError."""
        return set(self._queue().get_job_ids())

    def forget(self, message_id: str) -> None:
        """Deletes what is left of a message that is not on the queue any more. Raises RedisError."""
        self.redis.delete(Message.key_for(message_id))
        self._queue().intermediate_queue.remove(message_id)

    def alive(self, worker: str) -> None:
        """Records that a worker is alive. RQ does not restore its own register if Redis loses it. Raises RedisError."""
        self.redis.set(_SIGN + worker, "", ex=3 * HEARTBEAT_SECONDS)

    def gone(self, worker: str) -> None:
        """Records that a worker has ended. Raises RedisError."""
        self.redis.delete(_SIGN + worker)

    def live_workers(self) -> int:
        """The number of workers with a heartbeat in the last 15 seconds. Raises RedisError."""
        return sum(1 for _ in self.redis.scan_iter(match=_SIGN + "*", count=1000))


def reconcile(repository: Repository, queue: Queue) -> int:
    """Sends every queued job that has no message, e.g. after Redis lost its data. Returns how many were sent.

    Raises RedisError.
    """
    jobs = repository.queued()
    if not jobs:
        return 0
    waiting = queue.waiting()
    sent = 0
    for job in jobs:
        if _message_id(job.job_id, job.attempt) in waiting or _settling(job):
            continue
        if job.sent_ago is not None:
            queue.forget(_message_id(job.job_id, job.attempt))
        queue.send(job.job_id, job.attempt)
        repository.sent(job.job_id, job.attempt)
        sent += 1
    return sent


def _settling(job: Waiting) -> bool:
    return job.sent_ago is not None and job.sent_ago < SETTLE_SECONDS


def _message_id(job_id: str, attempt: int) -> str:
    return f"{job_id}-{attempt}"
