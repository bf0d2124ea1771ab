"""Two machines with nothing in common but PostgreSQL, Redis over TCP and an object store finish a campaign, and its
results are those of one worker on one machine.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from scene_attack_service.jobs.queue import Queue, connect
from scene_attack_service.settings import Settings
from tests import redis_over_tcp
from tests.integration.conftest import PATIENCE, Stack, end, until
from tests.integration.specs import long
from tests.postgresql import Postgresql, free_port

pytestmark = pytest.mark.integration

CUBE = b"""v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
"""An uploaded mesh, which the workers must have from the store."""


@contextmanager
def program(folder: Path, *command: str, **environ: str) -> Iterator[Path]:
    """Runs a part of the service on a machine of its own: its data, and its cache without the meshes that others have
    read. Ends it on leaving. Yields its log."""
    cache = folder / "cache"
    cache.mkdir(parents=True)
    for entry in Settings().cache_dir.iterdir():
        if entry.name != "meshes":
            (cache / entry.name).symlink_to(entry)
    machine = {
        "SCENE_ATTACK_DATA": str(folder / "data"),
        "SCENE_ATTACK_CACHE": str(cache),
        "SCENE_ATTACK_THREADS": "1",
        "SCENE_ATTACK_CHECK_SECONDS": "120",
    }
    environ = os.environ | machine | environ
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "scene_attack", *command], env=environ, stderr=log, start_new_session=True
        )
    try:
        yield folder / "log"
    finally:
        end(process, signal.SIGTERM)


def without_time(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in record.items() if name != "seconds"}


def results(client: httpx.Client) -> tuple[list[Any], list[Any]]:
    """Runs the campaign. Returns the hashes, the outcome and the trace of each job, and the table."""
    files = {"file": ("cube.obj", CUBE)}
    mesh = client.post("/v1/assets", files=files, data={"kind": "obj"}).raise_for_status().json()["name"]
    job = long(25)
    grid = {
        "scenes": {"meshes": [mesh], "views": [0.1, 0.2, 0.3, 0.4], "camera": job["scene"]["camera"]},
        "goal": job["goal"],
        "attacks": [{"name": "image", "attack": job["attack"]}],
        "selection": {"right": False},
    }
    answer = client.post("/v1/campaigns", json={"name": "c", "grids": [grid]}).raise_for_status()
    path = f"/v1/campaigns/{answer.json()['id']}"
    until(lambda: client.get(path).json()["state"] == "finished", "the campaign ends", 3 * PATIENCE)
    found = []
    for planned in client.get(f"{path}/jobs").json()["items"]:
        assert planned["state"] == "succeeded"
        job_path = f"/v1/jobs/{planned['job']}"
        listed = client.get(f"{job_path}/artifacts").json()["items"]
        hashes = {one["name"]: one["sha256"] for one in listed if not one["name"].endswith(".json")}
        image = client.get(f"{job_path}/artifacts/attacked.png", headers={"Range": "bytes=0-3"})
        assert (image.status_code, image.content) == (206, b"\x89PNG")
        job = client.get(job_path).json()
        found.append((hashes, [without_time(row) for row in (job["outcome"], *job["result"]["trace"])]))
    cells = client.get(f"{path}/table.json").json()["table"]["cells"]
    return found, [{name: cell[name] for name in ("jobs", "ended", "failed", "outcomes")} for cell in cells]


def taken(log: Path) -> int:
    """The number of jobs that the workers of a log took."""
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    return sum(line["event"] == "job taken" for line in lines)


def test_two_machines_finish_a_campaign_with_the_results_of_one(
    stack: Stack, tmp_path: Path, postgresql_server: Postgresql, s3_url: str
) -> None:
    with ExitStack() as machines:
        redis_url = redis_over_tcp.url(machines.enter_context(redis_over_tcp.running()))
        shared = {
            "SCENE_ATTACK_DATABASE_URL": postgresql_server.url(postgresql_server.create()),
            "SCENE_ATTACK_REDIS_URL": redis_url,
            "SCENE_ATTACK_ARTIFACT_URL": s3_url,
        }
        port = free_port()
        machines.enter_context(program(tmp_path / "api", "api", "--port", str(port), **shared))
        logs = [machines.enter_context(program(tmp_path / name, "worker", **shared)) for name in ("one", "two")]
        client = machines.enter_context(httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE))
        redis = machines.enter_context(connect(redis_url))
        until(lambda: Queue(redis).live_workers() == 2, "both workers are there", 2 * PATIENCE)
        together = results(client)
        assert all(taken(log) > 0 for log in logs)
        for name in ("api", "one", "two"):
            left = {path.name for path in (tmp_path / name / "data").rglob("*") if path.is_file()}
            assert left <= {"reserve"}, "a machine keeps nothing of jobs that have ended"
    assert results(stack.client) == together
