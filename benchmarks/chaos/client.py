"""A client that goes on asking while the service dies and comes back, and what it reads of jobs to compare them."""

import hashlib
import json
import time
from collections import Counter
from typing import Any

import httpx

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
        found: dict[str, Any] = self._ask("GET", f"/v1/jobs/{job_id}").json()
        return found

    def cancel(self, job_id: str) -> None:
        """Asks a job to stop."""
        self._ask("POST", f"/v1/jobs/{job_id}/cancel")

    def files(self, job_id: str) -> dict[str, str]:
        """The contents of a job's files by name: records as JSON without the times in them, others as their SHA-256."""
        found = {}
        for item in self._ask("GET", f"/v1/jobs/{job_id}/artifacts").json()["items"]:
            name = item["name"]
            data = self._ask("GET", f"/v1/jobs/{job_id}/artifacts/{name}").content
            if name.endswith(".json"):
                found[name] = json.dumps(without_times(json.loads(data)), sort_keys=True)
            else:
                found[name] = hashlib.sha256(data).hexdigest()
        return found

    def _ask(self, method: str, path: str, **request: Any) -> httpx.Response:
        deadline = time.monotonic() + self._patience
        while True:
            try:
                answer = self._http.request(method, path, **request)
            except httpx.TransportError as error:
                said = type(error).__name__
            else:
                if answer.is_success:
                    return answer
                said = str(answer.status_code)
                if answer.is_client_error:
                    raise RuntimeError(f"{method} {path}: {said} {answer.text[:500]}")
            self.errors[said] += 1
            if time.monotonic() > deadline:
                raise TimeoutError(f"{method} {path}: {said}")
            time.sleep(PAUSE)


def differences(one: Any, other: Any, where: str = "") -> list[str]:
    """The places where two records differ, each with both values."""
    if isinstance(one, dict) and isinstance(other, dict):
        names = sorted(one.keys() | other.keys())
        return [said for name in names for said in differences(one.get(name), other.get(name), f"{where}.{name}")]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return [said for n, (a, b) in pairs for said in differences(a, b, f"{where}.{n}")]
    return [] if one == other else [f"{where}: {str(one)[:80]} not {str(other)[:80]}"]


def without_times(found: Any) -> Any:
    """A record without its seconds, which differ from run to run."""
    if isinstance(found, dict):
        return {name: without_times(value) for name, value in found.items() if name != "seconds"}
    return [without_times(value) for value in found] if isinstance(found, list) else found
