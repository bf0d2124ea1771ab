"""Which worker runs which job, in which order, and why jobs wait. Redis only rings: what runs is decided here.

A job needs networks, and may ask for a device and for memory; a worker announces what it has, and takes only jobs whose
needs it meets.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Self

from pydantic.dataclasses import dataclass as validated
from sqlalchemy import func, select, update
from sqlalchemy.orm import aliased

from services.jobs.database import Database
from services.jobs.models import Job, State, not_paused
from services.jobs.states import Priority

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
