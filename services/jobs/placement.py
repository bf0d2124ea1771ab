"""Which worker may run which job, and why jobs wait. A job needs networks, and may ask for a device and for memory;
a worker announces what it has, and takes only jobs whose needs it meets.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, Literal, Self

Device = Literal["cpu", "cuda"]


class Priority(StrEnum):
    """The order in which jobs are taken: those of a higher priority first, and within one the owners in turn."""

    HIGH = "high"
    NORMAL = "normal"
    LOW = "low"


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


def _is_names(data: object) -> bool:
    return isinstance(data, list) and all(isinstance(item, str) for item in data)


ANY_WORKER = Needs()
"""The needs of a job that any worker may run."""


@dataclass(frozen=True)
class Demand:
    """Demand of a sender on the queue, for a job or a campaign. It is no part of the request and changes no result."""

    priority: Priority = Priority.NORMAL
    device: Device | None = None
    memory: int = 0

    @classmethod
    def of(cls, record: Mapping[str, Any] | None) -> Self:
        """The demand that the database has of a campaign as JSON."""
        return cls() if record is None else cls(Priority(record["priority"]), record["device"], record["memory"])

    def record(self) -> dict[str, Any]:
        """The demand as JSON."""
        return asdict(self)

    def needs(self, targets: Iterable[str]) -> Needs:
        """The needs of a job with these networks."""
        return Needs(tuple(sorted(set(targets))), self.device, self.memory)


NO_DEMAND = Demand()
"""A job of normal priority that any worker with its networks may run."""
CAMPAIGNS = Demand(Priority.LOW)
"""Demand of campaigns that ask for nothing else: single jobs come first."""


@dataclass(frozen=True)
class Abilities:
    """Abilities of a worker: its kind of device, the names of its networks, and the memory of a job in bytes."""

    device: str = "cpu"
    targets: frozenset[str] = field(default_factory=frozenset)
    memory: int = 0

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> Self:
        """The abilities that a message has as JSON. Raises ValueError if it has none."""
        try:
            device, targets, memory = record["device"], record["targets"], record["memory"]
        except (KeyError, TypeError) as error:
            raise ValueError("these are no abilities of a worker") from error
        if not isinstance(device, str) or not _is_names(targets) or type(memory) is not int:
            raise ValueError("these are no abilities of a worker")
        return cls(device, frozenset(targets), memory)

    def record(self) -> dict[str, Any]:
        """The abilities as JSON."""
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


NOTHING = Abilities()
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
