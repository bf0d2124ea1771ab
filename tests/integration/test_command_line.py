"""The command line against the real stack."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.conftest import Stack
from tests.integration.specs import ENDLESS, QUICK
from tests.unit.client.command_line import Done, process
from tests.unit.client.command_line import cli as run

pytestmark = pytest.mark.integration


def cli(stack: Stack, *arguments: str, spec: dict[str, Any] | None = None) -> Done:
    return run(*arguments, "--url", str(stack.client.base_url), stdin="" if spec is None else json.dumps(spec))


def test_submit_watch_download_and_replay(stack: Stack, tmp_path: Path) -> None:
    done = cli(stack, "submit", "-", "--watch", "--seed", "5", "--json", spec=QUICK)
    assert done.returncode == 0, done.stderr
    job = json.loads(done.stdout)
    assert job["state"] == "succeeded"
    assert job["seed"] == 5
    assert "attacking" in done.stderr
    listed = json.loads(cli(stack, "jobs", "list", "--state", "succeeded", "--json").stdout)
    assert job["id"] in [item["id"] for item in listed["items"]]
    assert "efficientnet-lite0" in cli(stack, "jobs", "list").stdout
    shown = cli(stack, "jobs", "show", job["id"])
    assert "sphere" in shown.stdout
    assert "image fgsm" in shown.stdout
    assert cli(stack, "jobs", "watch", job["id"]).returncode == 0
    assert cli(stack, "jobs", "download", job["id"], "--out", str(tmp_path)).returncode == 0
    assert json.loads((tmp_path / "result.json").read_text()) == job["result"]
    assert run("replay", str(tmp_path)).returncode == 0


def test_cancel_and_watch_a_cancelled_job(stack: Stack) -> None:
    job_id = cli(stack, "submit", "-", spec=ENDLESS).stdout.split()[0]
    stack.attacking(job_id)
    assert cli(stack, "jobs", "cancel", job_id).returncode == 0
    watched = cli(stack, "jobs", "watch", job_id)
    assert watched.returncode == 1
    assert "cancelled" in watched.stdout


def test_a_refusal_names_the_field_and_exits_2(stack: Stack) -> None:
    bad = QUICK | {"target": {"name": "alexnet-9"}}
    done = cli(stack, "submit", "-", spec=bad)
    assert done.returncode == 2
    assert "target.name" in done.stderr
    assert cli(stack, "jobs", "show", "nothing").returncode == 2


def test_doctor_tries_drivers_kernels_and_weights(tmp_path: Path) -> None:
    done = process("doctor", "--json", SCENE_ATTACK_DATA=str(tmp_path), PYOPENGL_PLATFORM="no-platform")
    found = {one["subject"]: one["level"] for one in json.loads(done.stdout)}
    assert (done.returncode, found["OpenGL"]) == (1, "fail")
    assert found["device"] == found["kernels"] == found["default network"] == found["Redis"] == "ok"


def test_doctor_names_a_device_that_is_not_there_once(tmp_path: Path) -> None:
    """The network cannot be tried on it, and has nothing to be mended."""
    done = process("doctor", "--json", SCENE_ATTACK_DATA=str(tmp_path), SCENE_ATTACK_DEVICE="cuda:99")
    failed = [one["subject"] for one in json.loads(done.stdout) if one["level"] == "fail"]
    assert (done.returncode, failed) == (1, ["device"])
