"""Jobs through the real stack."""

import hashlib
import json
import tomllib
from typing import Any

import httpx
import pytest
from httpx_sse import connect_sse

from tests.integration.conftest import Stack, until
from tests.integration.specs import ENDLESS, QUICK, long, scene
from tests.packages import ROOT

pytestmark = pytest.mark.integration

PLUGINS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["scene_attack.plugins"]
FILES = {
    "result.json",
    "trace.json",
    "perturbation.safetensors",
    "original.png",
    "attacked.png",
    "perturbation.png",
}


def events(stack: Stack, job_id: str, after: int = 0) -> list[tuple[int, str, dict[str, Any]]]:
    headers = {"Last-Event-ID": str(after)}
    with connect_sse(stack.client, "GET", f"/v1/jobs/{job_id}/events", headers=headers) as stream:
        return [(int(event.id), event.event, event.json()) for event in stream.iter_sse()]


def test_a_job_runs_to_its_end_and_says_everything(stack: Stack) -> None:
    job_id = stack.submit(QUICK)
    job = stack.ended(job_id)
    assert job["state"] == "succeeded", job["failure"]
    assert list(job["times"]) == ["queued", "running", "succeeded"]
    assert job["result"]["spec"] == job["spec"]
    assert job["outcome"]["fooled"] == job["result"]["verdict"]["fooled"]
    assert job["outcome"]["perceptibility"] == job["result"]["change"]["perceptibility"]

    files = {file["name"]: file for file in stack.client.get(f"/v1/jobs/{job_id}/artifacts").json()["items"]}
    assert set(files) == FILES
    for name, file in files.items():
        answer = stack.client.get(f"/v1/jobs/{job_id}/artifacts/{name}")
        assert hashlib.sha256(answer.content).hexdigest() == file["sha256"]
        assert answer.headers["etag"] == f'"{file["sha256"]}"'
    result = stack.client.get(f"/v1/jobs/{job_id}/artifacts/result.json")
    assert json.loads(result.content) == job["result"]
    assert stack.client.get(f"/v1/jobs/{job_id}/artifacts/original.png").content.startswith(b"\x89PNG")

    listed = stack.client.get("/v1/jobs", params={"state": "succeeded"}).json()["items"]
    assert job_id in {one["id"] for one in listed}
    assert not (stack.data / "checkpoints" / job_id).exists()


def test_its_events_tell_every_step_once_and_can_be_resumed(stack: Stack) -> None:
    job_id = stack.submit(long(20))
    told = events(stack, job_id)  # live, from before it ran
    assert [number for number, _, _ in told] == list(range(1, len(told) + 1))
    assert [data["state"] for _, kind, data in told if kind == "state"] == ["queued", "running", "succeeded"]
    rows = [row for _, kind, data in told if kind == "progress" for row in data["rows"]]
    assert rows == stack.job(job_id)["result"]["trace"]
    assert events(stack, job_id, after=2) == told[2:]


def test_an_answer_can_be_waited_for(stack: Stack) -> None:
    answer = stack.client.post("/v1/jobs", json=QUICK, headers={"Prefer": "wait=30"})
    assert answer.status_code == 200
    assert answer.json()["state"] == "succeeded"
    assert answer.json()["result"]["original"]["label"] == answer.json()["spec"]["goal"]["leave"]


def test_processes_stay_warm_between_jobs(stack: Stack) -> None:
    stack.ended(stack.submit(QUICK))
    before = stack.one("scene_attack_worker.job_process").pid
    stack.ended(stack.submit(QUICK))
    assert stack.one("scene_attack_worker.job_process").pid == before


def test_cancel_stops_a_running_job_within_one_step(stack: Stack) -> None:
    job_id = stack.submit(ENDLESS)
    stack.attacking(job_id, step=3)
    asked = stack.client.post(f"/v1/jobs/{job_id}/cancel").json()
    assert asked["state"] in ("cancelling", "cancelled")
    job = stack.ended(job_id)
    assert job["state"] == "cancelled"
    assert job["result"] is None
    kinds = [data.get("state", "progress") for _, _, data in events(stack, job_id)]
    # A running job reports four times a second; of the step it was in when it was asked, at most once.
    assert kinds[kinds.index("cancelling") + 1 :] in (["cancelled"], ["progress", "cancelled"])
    assert stack.client.post(f"/v1/jobs/{job_id}/cancel").json()["state"] == "cancelled"
    assert not (stack.data / "checkpoints" / job_id).exists()
    # The process that ran it is warm for the next.
    assert stack.ended(stack.submit(QUICK))["state"] == "succeeded"


def test_a_queued_job_is_cancelled_and_never_runs(stack: Stack) -> None:
    first = stack.submit(ENDLESS)
    stack.attacking(first)
    second = stack.submit(QUICK)
    assert stack.client.post(f"/v1/jobs/{second}/cancel").json()["state"] == "cancelled"
    stack.client.post(f"/v1/jobs/{first}/cancel")
    stack.ended(first)
    assert stack.ended(stack.submit(QUICK))["state"] == "succeeded"
    assert list(stack.job(second)["times"]) == ["queued", "cancelled"]


def test_a_job_fails_by_name_when_its_mesh_has_gone(stack: Stack) -> None:
    import trimesh

    data = trimesh.creation.icosphere(subdivisions=2).export(file_type="stl")
    name = stack.client.post("/v1/assets", files={"file": data}, data={"kind": "stl"}).json()["name"]
    blocker = stack.submit(ENDLESS)
    stack.attacking(blocker)
    body = QUICK | {"scene": scene() | {"objects": [{"mesh": name}]}}
    job_id = stack.submit(body)
    for file in (stack.data / "assets").glob(f"{name.removeprefix('sha256:')}*"):
        file.unlink()
    stack.client.post(f"/v1/jobs/{blocker}/cancel")
    job = stack.ended(job_id)
    assert job["state"] == "failed"
    assert job["failure"]["kind"] == "asset-missing"
    assert name in job["failure"]["detail"]


def test_an_upload_that_is_too_large_is_heard_out_and_refused(stack: Stack) -> None:
    try:
        answer = stack.client.post("/v1/assets", files={"file": bytes(40 * 2**20)}, data={"kind": "stl"})
    except httpx.TransportError as error:  # pragma: no cover - would be the bug
        pytest.fail(f"the connection was cut before the answer: {error}")
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "file"


def test_ready_means_a_worker(stack: Stack) -> None:
    def answer() -> dict[str, Any]:
        found: dict[str, Any] = stack.client.get("/readyz").json()
        return found

    parts = dict.fromkeys(("ready", "database", "redis", "storage", "worker"), True)
    ready = answer()
    loaded = [(plugin["name"], plugin["error"]) for plugin in ready.pop("plugins")]
    assert loaded == [(name, None) for name in sorted(PLUGINS)]
    assert ready == parts | {"workers": 1, "targets": []}
    until(lambda: answer()["workers"] == 1, "the worker keeps saying that it lives")
