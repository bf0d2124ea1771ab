"""The queues: RQ on Redis carries job ids to workers. If Redis loses them, they are sent again from the record.

There is a queue for each priority and each set of needs; a worker listens to those whose needs it meets.

RQ is transport and no more: no function that a message names is imported or called. Whoever can write to Redis can
start a job that is queued, at most. Whether the job may run, and what it is, a worker reads from the record.
"""

import json
import re
from contextlib import suppress
from dataclasses import dataclass
from typing import cast

import rq
from redis import Redis
from rq.exceptions import DeserializationError, DuplicateJobError
from rq.job import Job as Message

from services.errors import InvalidRequest
from services.jobs.placement import ANY_WORKER, NOTHING, Abilities, Needs, Priority

SETTING = "SCENE_ATTACK_REDIS_URL"
NAME = "scene-attack"
TASK = "run_job"
"""What a message asks for. No function has this name."""
HEARTBEAT_SECONDS = 5
"""Longest time between two heartbeats of a worker."""
ANSWER_SECONDS = 3
"""Time after which Redis is taken to be away."""
MOST_EMPTY = 100
"""Empty queues whose names are kept: a worker listens to a new one after its next heartbeat."""
_PREFIX: str = rq.Queue.redis_queue_namespace_prefix
_SIGN = f"{NAME}:worker:"
_ID = re.compile(r"[0-9a-f]{32}")
_NAME = re.compile(f"{NAME}:(?:{'|'.join(Priority)}):(.+)")


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


def queue_name(priority: Priority, needs: Needs) -> str:
    """The name of the queue of jobs with this priority and these needs."""
    return f"{NAME}:{priority}:{needs.text}"


def priority_of(name: str) -> Priority:
    """The priority of the jobs of a queue."""
    return Priority(name.split(":")[1])


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

    def _queue(self, name: str) -> rq.Queue:
        return rq.Queue(name, connection=self.redis, serializer="json")

    def send(self, job_id: str, attempt: int, priority: Priority = Priority.NORMAL, needs: Needs = ANY_WORKER) -> None:
        """Puts a job's id on its queue, once. `attempt` is the number of attempts it has had. Raises RedisError."""
        with suppress(DuplicateJobError):
            self._queue(queue_name(priority, needs)).enqueue_call(
                TASK,
                args=(job_id,),
                job_id=message_id(job_id, attempt),
                unique=True,
                timeout=-1,  # limits are the worker's own
                result_ttl=0,
                description=job_id,
            )

    def waiting(self) -> set[str]:
        """Ids of the messages on all queues. Forgets empty queues if there are many: clients choose what jobs need.

        Raises RedisError.
        """
        keys = [key for key in self._keys() if key.startswith(f"{_PREFIX}{NAME}:".encode())]
        with self.redis.pipeline(transaction=False) as together:
            for key in keys:
                together.lrange(key, 0, -1)
            said = together.execute(raise_on_error=False)
        # What somebody planted under the name of a queue is none, and keeps nothing else from being sent.
        found = {key: messages for key, messages in zip(keys, said, strict=True) if isinstance(messages, list)}
        empty = [key for key, messages in found.items() if not messages]
        if len(empty) > MOST_EMPTY:
            self.redis.srem(rq.Queue.redis_queues_keys, *empty)  # a queue is added again with its next message
        return {message.decode(errors="replace") for messages in found.values() for message in messages}

    def for_worker(self, abilities: Abilities) -> list[str]:
        """The names of the queues that a worker listens to, in the order of their priorities. Raises RedisError."""
        needs = {ANY_WORKER, *(Needs((target,)) for target in abilities.targets)}
        for name in self._names():
            found = _NAME.fullmatch(name)
            if found is not None:
                with suppress(ValueError):  # what somebody planted
                    needs.add(Needs.read(found[1]))
        mine = sorted((one for one in needs if abilities.lacks(one) is None), key=lambda one: one.text)
        return [queue_name(priority, one) for priority in Priority for one in mine]

    def _keys(self) -> set[bytes]:
        return cast(set[bytes], self.redis.smembers(rq.Queue.redis_queues_keys))

    def _names(self) -> list[str]:
        return sorted(key.decode(errors="replace").removeprefix(_PREFIX) for key in self._keys())

    def forget(self, message_id: str) -> None:
        """Deletes what is left of a message that is on no queue any more. Raises RedisError."""
        self.redis.delete(Message.key_for(message_id))

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
        """What the workers with a heartbeat in the last 15 seconds have. Raises RedisError."""
        keys = list(self.redis.scan_iter(match=_SIGN + "*", count=1000))
        said = cast(list[bytes | None], self.redis.mget(keys)) if keys else []
        found = []
        for one in said:
            with suppress(ValueError, RecursionError):  # what somebody planted
                found.append(Abilities.of(json.loads(one or b"")))
        return found


def message_id(job_id: str, attempt: int) -> str:
    """The id of the message that stands for a queued job which has had so many attempts."""
    return f"{job_id}-{attempt}"
