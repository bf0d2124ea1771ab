"""Counts of a run: the outcomes of its jobs, and their differences from undisturbed ones. The client keeps asking while
the service dies and comes back.
"""

import hashlib
import json
import time
from collections import Counter
from typing import Any

import httpx
from sqlalchemy import func, select

from scene_attack_service.jobs.models import Job, JobKind
from scene_attack_service.jobs.record import Record

ENDED = ("succeeded", "failed", "rejected", "cancelled")
PAUSE = 0.2
"""Time between two tries, in seconds."""


class Client:
    """Asks the service at `url` until it answers, at most for `patience` seconds. `errors` counts other answers."""

    def __init__(self, url: str, patience: float) -> None:
        self._http = httpx.Client(base_url=url, timeout=20, trust_env=False)
        self._patience = patience
        self.errors: Counter[str] = Counter()

    def close(self) -> None:
        """Closes the connections."""
        self._http.close()

    def submit(self, request: dict[str, Any], key: str) -> str:
        """Submits a job and returns its id. The same key makes one job, however often the service dies meanwhile."""
        return str(self._ask("POST", "/v1/jobs", json=request, headers={"Idempotency-Key": key}).json()["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        """A job with its result."""
        answer: dict[str, Any] = self._ask("GET", f"/v1/jobs/{job_id}").json()
        return answer

    def cancel(self, job_id: str) -> None:
        """Asks a job to stop."""
        self._ask("POST", f"/v1/jobs/{job_id}/cancel")

    def files(self, job_id: str) -> dict[str, str]:
        """The contents of a job's files by name: records as JSON without the times in them, others as their SHA-256."""
        contents = {}
        for item in self._ask("GET", f"/v1/jobs/{job_id}/artifacts").json()["items"]:
            name = item["name"]
            data = self._ask("GET", f"/v1/jobs/{job_id}/artifacts/{name}").content
            if name.endswith(".json"):
                contents[name] = json.dumps(without_times(json.loads(data)), sort_keys=True)
            else:
                contents[name] = hashlib.sha256(data).hexdigest()
        return contents

    def _ask(self, method: str, path: str, **request: Any) -> httpx.Response:
        deadline = time.monotonic() + self._patience
        while True:
            try:
                answer = self._http.request(method, path, **request)
            except httpx.TransportError as error:
                problem = type(error).__name__
            else:
                if answer.is_success:
                    return answer
                problem = str(answer.status_code)
                if answer.is_client_error:
                    raise RuntimeError(f"{method} {path}: {problem} {answer.text[:500]}")
            self.errors[problem] += 1
            if time.monotonic() > deadline:
                raise TimeoutError(f"{method} {path}: {problem}")
            time.sleep(PAUSE)


def differences(one: Any, other: Any, where: str = "") -> list[str]:
    """The places where two records differ, each with both values."""
    if isinstance(one, dict) and isinstance(other, dict):
        names = sorted(one.keys() | other.keys())
        return [
            difference
            for name in names
            for difference in differences(one.get(name), other.get(name), f"{where}.{name}")
        ]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return [difference for n, (a, b) in pairs for difference in differences(a, b, f"{where}.{n}")]
    return [] if one == other else [f"{where}: {str(one)[:80]} not {str(other)[:80]}"]


def without_times(found: Any) -> Any:
    """A record without its seconds, which differ from run to run."""
    if isinstance(found, dict):
        return {name: without_times(value) for name, value in found.items() if name != "seconds"}
    return [without_times(value) for value in found] if isinstance(found, list) else found


def counts(client: Client, record: Record, ids: list[str], undisturbed: list[dict[str, str]]) -> dict[str, Any]:
    """Counts the outcomes of the submitted jobs `ids`, which are of the kinds of `undisturbed` in turn. "ok" is whether
    every job has one result, with the files of its kind, and there is no other job.
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
            different_places = _differences(client.files(job_id), undisturbed[number % len(undisturbed)])
            identical += not different_places
            if different_places:
                different.append(
                    {"kind": number % len(undisturbed), "attempts": job["attempt"], "differences": different_places}
                )
    recorded = _recorded(record)
    expected = len(ids) + len(undisturbed)
    return {
        "ok": len(set(ids)) == len(ids) == identical == results and recorded == expected,
        "jobs": len(ids),
        "states": dict(states),
        "failures": dict(failures),
        "identical to an undisturbed run": identical,
        "different": different,
        "results": results,
        "jobs that nobody submitted": recorded - expected,
        "attempts": dict(sorted(attempts.items())),
    }


def _differences(files: dict[str, str], undisturbed: dict[str, str]) -> list[str]:
    """Places at which a job's files differ from those of an undisturbed one, at most ten in each file."""
    places = []
    for name in sorted(files.keys() | undisturbed.keys()):
        if name.endswith(".json") and name in files and name in undisturbed:
            places += differences(json.loads(files[name]), json.loads(undisturbed[name]), name)[:10]
        elif files.get(name) != undisturbed.get(name):
            places.append(name)
    return places


def _recorded(record: Record) -> int:
    with record.database.read() as session:
        return session.scalar(select(func.count()).select_from(Job).where(Job.kind == JobKind.ATTACK)) or 0
