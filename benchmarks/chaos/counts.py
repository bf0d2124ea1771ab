"""What a run found: what became of its jobs, and how they compare with undisturbed ones."""

import json
from collections import Counter
from typing import Any

from sqlalchemy import func, select

from benchmarks.chaos.client import Client, differences
from benchmarks.chaos.faults import Fault
from benchmarks.chaos.recovery import gaps, recovery
from services.jobs.models import Job, JobKind
from services.jobs.record import Record


def counts(client: Client, record: Record, ids: list[str], undisturbed: list[dict[str, str]]) -> dict[str, Any]:
    """What became of the submitted jobs `ids`, which are of the kinds of `undisturbed` in turn. "ok" is whether every
    one has one result, with the files of its kind, and there is no other job.
    """
    states: Counter[str] = Counter()
    failures: Counter[str] = Counter()
    attempts: Counter[str] = Counter()
    different: list[dict[str, Any]] = []
    identical = results = 0
    for number, job_id in enumerate(ids):
        job = client.job(job_id)
        states[job["state"]] += 1
        attempts[str(job["attempt"])] += 1
        if job["failure"] is not None:
            failures[job["failure"]["kind"]] += 1
        ends = [event for event in record.jobs.events(job_id, 0, limit=10**6) if event.data.get("state") == "succeeded"]
        results += len(ends)
        if job["state"] == "succeeded":
            said = _differences(client.files(job_id), undisturbed[number % len(undisturbed)])
            identical += not said
            if said:
                different.append({"kind": number % len(undisturbed), "attempts": job["attempt"], "differences": said})
    recorded = _recorded(record)
    wanted = len(ids) + len(undisturbed)
    return {
        "ok": len(set(ids)) == len(ids) == identical == results and recorded == wanted,
        "jobs": len(ids),
        "states": dict(states),
        "failures": dict(failures),
        "identical to an undisturbed run": identical,
        "different": different,
        "results": results,
        "jobs that nobody submitted": recorded - wanted,
        "attempts": dict(sorted(attempts.items())),
    }


def _differences(found: dict[str, str], wanted: dict[str, str]) -> list[str]:
    """Where a job's files differ from those of an undisturbed one, at most ten places of each file."""
    said = []
    for name in sorted(found.keys() | wanted.keys()):
        if name.endswith(".json") and name in found and name in wanted:
            said += differences(json.loads(found[name]), json.loads(wanted[name]), name)[:10]
        elif found.get(name) != wanted.get(name):
            said.append(name)
    return said


def _recorded(record: Record) -> int:
    with record.database.read() as session:
        return session.scalar(select(func.count()).select_from(Job).where(Job.kind == JobKind.ATTACK)) or 0


def recoveries(record: Record, ids: list[str], faults: list[Fault]) -> dict[str, Any]:
    """How long the jobs stood still after faults of each kind, and from where they went on."""
    return recovery([gap for job_id in ids for gap in gaps(record.jobs.events(job_id, 0, limit=10**6))], faults)
