"""How long jobs stood still: from a fault to the next step of the job it hit, read from the events of the record."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from benchmarks.chaos.faults import Fault
from services.jobs.models import Event

HOLDING = ("worker.job_process", "worker.rq_worker", "supervisor")
"""What a running job stands still without."""
NEAR = 1.0
"""Seconds by which the last report before a fault may lie after it: reports are written a moment later."""


@dataclass(frozen=True)
class Gap:
    """The time in which a job stood still: from its last report before an attempt was lost to the first after."""

    began: float
    ended: float


def gaps(events: Iterable[Event]) -> list[Gap]:
    """The gaps between the attempts of a job."""
    found = []
    last: float | None = None
    waiting = False
    for event in events:
        at = event.created_at.timestamp()
        if event.kind == "progress" and event.data["phase"] != "loading":
            if waiting and last is not None:
                found.append(Gap(last, at))
            last, waiting = at, False
        elif event.kind == "state" and event.data["state"] == "queued" and last is not None:
            waiting = True
    return found


def recovery(found: Sequence[Gap], faults: Sequence[Fault]) -> dict[str, dict[str, float]]:
    """For each kind of fault and target, the number of gaps that began with one, and their median and longest seconds.

    A gap with further such faults in it is left out, since it says how long several of them took.
    """
    seconds: dict[str, list[float]] = {}
    for gap in found:
        within = [one for one in faults if one.target in HOLDING and gap.began - NEAR <= one.at <= gap.ended]
        if len(within) == 1:
            [fault] = within
            seconds.setdefault(f"{fault.kind} {fault.target}", []).append(gap.ended - max(gap.began, fault.at))
    return {
        name: {"gaps": len(all_), "median s": round(median(all_), 1), "longest s": round(max(all_), 1)}
        for name, all_ in sorted(seconds.items())
    }
