"""How long jobs stood still, and from which step they went on: from a fault to the next step of the job it hit, read
from the events of the record.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from benchmarks.chaos.databases import BACKEND, DATABASE, POSTMASTER
from benchmarks.chaos.faults import Fault
from services.jobs.models import Event

HOLDING = ("worker.job_process", "worker.rq_worker", "supervisor", DATABASE, POSTMASTER, BACKEND)
"""What a running job stands still without."""
NEAR = 1.0
"""Seconds by which the last report before a fault may lie after it: reports are written a moment later."""


@dataclass(frozen=True)
class Gap:
    """The time in which a job stood still: from its last report before an attempt was lost to the first after.

    `worked` is how long the lost attempt had taken steps, in seconds. `reached` is its last step, and `resumed` the
    first of the next attempt: 0 if that began again.
    """

    began: float
    ended: float
    worked: float
    reached: int
    resumed: int


def gaps(events: Iterable[Event]) -> list[Gap]:
    """The gaps between the attempts of a job."""
    found = []
    first: float | None = None
    last, reached = 0.0, 0
    waiting = False
    for event in events:
        at = event.created_at.timestamp()
        if event.kind == "progress" and event.data["phase"] != "loading":
            rows = event.data.get("rows") or [{"step": event.data["step"]}]
            if waiting and first is not None:
                found.append(Gap(last, at, last - first, reached, rows[0]["step"]))
            if waiting or first is None:
                first = at
            last, reached, waiting = at, rows[-1]["step"], False
        elif event.kind == "state" and event.data["state"] == "queued" and first is not None:
            waiting = True
    return found


def recovery(found: Sequence[Gap], faults: Sequence[Fault]) -> dict[str, dict[str, float]]:
    """For each kind of fault and target, the number of gaps that began with one, their median and longest seconds, how
    many attempts went on from a checkpoint, and how long those at most had worked that began again.

    A gap with further such faults in it is left out, since it says how long several of them took.
    """
    hit: dict[str, list[tuple[Gap, float]]] = {}
    for gap in found:
        within = [one for one in faults if one.target in HOLDING and gap.began - NEAR <= one.at <= gap.ended]
        if len(within) == 1:
            [fault] = within
            hit.setdefault(f"{fault.kind} {fault.target}", []).append((gap, gap.ended - max(gap.began, fault.at)))
    return {name: _summary(all_) for name, all_ in sorted(hit.items())}


def _summary(hit: Sequence[tuple[Gap, float]]) -> dict[str, float]:
    seconds = [time for _, time in hit]
    again = [gap.worked for gap, _ in hit if gap.resumed == 0]
    return {
        "gaps": len(hit),
        "median s": round(median(seconds), 1),
        "longest s": round(max(seconds), 1),
        "from a checkpoint": len(hit) - len(again),
        "most steps repeated": max(gap.reached + 1 - gap.resumed for gap, _ in hit),
        "longest s of steps before one began again": round(max(again, default=0.0), 1),
    }
