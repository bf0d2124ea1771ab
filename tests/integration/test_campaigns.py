"""A campaign through the real stack: paused, resumed, with a worker killed under it, and taken again."""

import re
from typing import Any

import pytest
import trimesh

from tests.integration.conftest import Stack, until
from tests.integration.specs import QUICK, long

pytestmark = pytest.mark.integration

STEPS = 60
"""A second or two of steps: time to pause, and to be killed in the middle."""


def campaign(name: str) -> dict[str, Any]:
    job = long(STEPS)
    grid = {
        "scenes": {"meshes": ["primitive/sphere"], "views": [0.1, 0.2, 0.3], "camera": job["scene"]["camera"]},
        "goal": job["goal"],
        "attacks": [{"name": "image", "attack": job["attack"]}],
        "selection": {"right": False},
    }
    return {"name": name, "grids": [grid]}


def start(stack: Stack, name: str) -> str:
    answer = stack.client.post("/v1/campaigns", json=campaign(name))
    assert answer.status_code == 202, answer.text
    return f"/v1/campaigns/{answer.json()['id']}"


def get(stack: Stack, path: str) -> dict[str, Any]:
    found: dict[str, Any] = stack.client.get(path).json()
    return found


def test_a_campaign_survives_a_killed_worker_and_a_pause(stack: Stack) -> None:
    one = start(stack, "first")

    def running() -> str | None:
        jobs = get(stack, f"{one}/jobs")["items"]
        return next((job["job"] for job in jobs if job["state"] == "running"), None)

    killed: str = until(running, "a job of the campaign runs")
    stack.attacking(killed)
    stack.one("scene_attack_worker.job_process").kill()
    assert stack.client.post(f"{one}/pause").json()["state"] == "paused"
    until(lambda: get(stack, one)["progress"]["running"] == 0, "nothing of the campaign runs")
    before = get(stack, one)["progress"]["ended"]
    assert before <= 1
    # The queue is free for others, and the campaign's own jobs stay where they are.
    assert stack.ended(stack.submit(QUICK))["state"] == "succeeded"
    held = get(stack, one)
    assert (held["state"], held["progress"]["running"]) == ("paused", 0)
    assert held["progress"]["ended"] <= before + 1
    assert any(job["state"] == "queued" for job in get(stack, f"{one}/jobs")["items"])
    assert stack.client.post(f"{one}/resume").json()["state"] == "running"
    until(lambda: get(stack, one)["state"] == "finished", "the campaign ends")
    jobs = get(stack, f"{one}/jobs")["items"]
    assert [job["state"] for job in jobs] == ["succeeded"] * 3
    assert stack.job(killed)["attempt"] == 2
    [cell] = get(stack, f"{one}/table.json")["table"]["cells"]
    assert (cell["jobs"], cell["ended"], cell["failed"], sum(cell["outcomes"].values())) == (3, 3, 0, 3)

    # The same requests again: the results are there.
    again = start(stack, "again")
    until(lambda: get(stack, again)["state"] == "finished", "the second campaign ends")
    assert [(job["job"], job["reused"]) for job in get(stack, f"{again}/jobs")["items"]] == [
        (job["job"], True) for job in jobs
    ]
    assert get(stack, again)["reused"] == 3


def test_a_campaign_calls_uploads_by_their_titles(stack: Stack) -> None:
    """Two uploads of one title stay two scenes of its tables."""
    names = []
    for subdivisions in (1, 2):
        ball = trimesh.creation.icosphere(subdivisions=subdivisions).export(file_type="obj")
        files = {"file": ("ball.obj", ball, "model/obj")}
        names.append(stack.client.post("/v1/assets", files=files, data={"name": "a red ball"}).json()["name"])
    spec = campaign("titles")
    spec["grids"][0]["scenes"] |= {"meshes": names, "views": [0.1]}
    spec["grids"][0]["attacks"][0]["attack"]["steps"] = 1
    answer = stack.client.post("/v1/campaigns", json=spec)
    assert answer.status_code == 202, answer.text
    address = f"/v1/campaigns/{answer.json()['id']}"
    until(lambda: get(stack, address)["state"] == "finished", "the campaign ends")
    titled = [f"a red ball ({name[:14]})" for name in names]
    assert [view["scene"] for view in get(stack, f"{address}/table.json")["views"]] == titled
    page = stack.client.get(address.removeprefix("/v1")).text
    assert names[0] not in page.split('<h2 id="spec">')[0]  # the request has the name itself
    heads = [
        re.findall(r"<th scope=\"col\"[^>]*>(.*?)</th>", head)
        for head in re.findall(r"<thead>(.*?)</thead>", page, re.S)
    ]
    assert ["p in the loop ×10⁻³" in columns for columns in heads].count(True) == 1
    assert all(len(set(columns)) == len(columns) for columns in heads)


def test_a_campaign_of_questions_is_read_by_the_supervisor_too(stack: Stack) -> None:
    """The models of its fields are a plug-in's, which every process that reads requests has to load."""
    grid = {
        "targets": ["iep"],
        "generate": {"images": 2, "seed": 8, "objects": [3, 4], "kinds": ["zero_hop"], "size": [60, 80]},
        "attacks": [{"name": "image", "attack": {"renderer": "image", "base_renderer": "pyrender", "steps": 1}}],
        "selection": {"right": False},
    }
    answer = stack.client.post("/v1/campaigns", json={"name": "questions", "grids": [grid]})
    assert answer.status_code == 202, answer.text
    path = f"/v1/campaigns/{answer.json()['id']}"
    ended = ("finished", "failed", "cancelled")
    until(lambda: get(stack, path)["state"] in ended, "the campaign has ended")
    assert get(stack, path)["state"] == "finished", get(stack, path)
    jobs = get(stack, f"{path}/jobs")["items"]
    asked = [stack.client.get(f"/v1/jobs/{job['job']}").json()["asked"] for job in jobs]
    assert len(asked) == 2
    assert all(asked)
