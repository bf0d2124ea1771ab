"""The queues: a bell for each priority, as a job of RQ on Redis, wakes a worker that waits. Workers also say that they
are alive here, and what they have.

A bell says that a job of its priority may be queued, and no more: which one runs, a worker asks the record. Nothing
that a message names is imported or called. Whoever can write to Redis can wake workers, at most.
"""

import json
from contextlib import suppress
from dataclasses import dataclass
from typing import cast

import rq
from redis import Redis
from rq.job import Job as Bell

from services.errors import InvalidRequest
from services.jobs.scheduler import NOTHING, Abilities, Scheduler, why_waiting
from services.jobs.states import Priority

SETTING = "SCENE_ATTACK_REDIS_URL"
NAME = "scene-attack"
HEARTBEAT_SECONDS = 5
"""Longest time between two heartbeats of a worker."""
ANSWER_SECONDS = 3
"""Time after which Redis is taken to be away."""
_SIGN = f"{NAME}:worker:"
_RING = "ring"
"""Function that a bell names, as RQ demands. No function has this name."""


def connect(url: str | None) -> Redis:
    """Returns a Redis client that gives up after 3 seconds without an answer.

    The URL begins with redis:, rediss: (TLS) or unix:, and may have a user and a password. Over TLS the server's
    certificate must be one that this machine trusts, or one of the file `?ssl_ca_certs=`. Raises InvalidRequest if
    there is no URL, or it is none of these.
    """
    if url is None:
        raise InvalidRequest(SETTING, "is needed where API and workers run apart; `scene-attack serve` brings a Redis")
    try:
        return Redis.from_url(url, socket_timeout=ANSWER_SECONDS, socket_connect_timeout=ANSWER_SECONDS)
    except ValueError as error:  # the URL itself may have a password and is not shown
        detail = "must be a URL such as redis://:password@host:6379/0, rediss://… for TLS, or unix:///path/of/socket"
        raise InvalidRequest(SETTING, detail) from error


def queue_name(priority: Priority) -> str:
    """The name of RQ's queue with the bells of a priority."""
    return f"{NAME}:{priority}"


def priority_of(name: str) -> Priority:
    """The priority of the queue with this name."""
    return Priority(name.removeprefix(f"{NAME}:"))


@dataclass(frozen=True)
class Queue:
    """The bells, and the signs of life of the workers that listen to them."""

    redis: Redis

    def _bells(self, priority: Priority) -> rq.Queue:
        return rq.Queue(queue_name(priority), connection=self.redis, serializer="json")

    def ring(self, priority: Priority = Priority.NORMAL, times: int = 1) -> None:
        """Wakes so many workers that wait, or that will. Raises RedisError."""
        for _ in range(times):
            self._bells(priority).enqueue_call(_RING, timeout=-1, result_ttl=0)  # limits are the worker's own

    def bells(self, priority: Priority) -> int:
        """The number of bells that no worker has answered. Raises RedisError."""
        return int(self._bells(priority).count)

    def answered(self, bell_id: str) -> None:
        """Deletes what is left of a bell that is on no queue any more. Raises RedisError."""
        self.redis.delete(Bell.key_for(bell_id))

    def alive(self, worker: str, abilities: Abilities = NOTHING) -> None:
        """Records that a worker is alive, and what it has. RQ does not restore its own register if Redis loses it.

        Raises RedisError.
        """
        self.redis.set(_SIGN + worker, json.dumps(abilities.record()), ex=3 * HEARTBEAT_SECONDS)

    def gone(self, worker: str) -> None:
        """Records that a worker has ended. Raises RedisError."""
        self.redis.delete(_SIGN + worker)

    def live_workers(self) -> int:
        """The number of workers with a heartbeat in the last 15 seconds. Raises RedisError."""
        return sum(1 for _ in self.redis.scan_iter(match=_SIGN + "*", count=1000))

    def workers(self) -> list[Abilities]:
        """Returns the abilities of the workers with a heartbeat in the last 15 seconds. Raises RedisError."""
        keys = list(self.redis.scan_iter(match=_SIGN + "*", count=1000))
        messages = cast(list[bytes | None], self.redis.mget(keys)) if keys else []
        abilities = []
        for message in messages:
            with suppress(ValueError, TypeError, RecursionError):  # what somebody planted
                abilities.append(Abilities(**json.loads(message or b"")))
        return abilities


def reconcile(scheduler: Scheduler, queue: Queue) -> None:
    """Records why queued jobs wait, and rings where a live worker can run one of them. Raises RedisError.

    There are then as many bells as workers: one that cannot run the job may answer first, and drops its bell.
    """
    workers = queue.workers()
    priorities: set[Priority] = set()
    for waiting in scheduler.waiting():
        why = why_waiting(waiting.needs, workers)
        if why != waiting.why:
            scheduler.explain(waiting, why)
        if why is None:
            priorities.add(waiting.priority)
    for priority in priorities:
        queue.ring(priority, len(workers) - queue.bells(priority))
