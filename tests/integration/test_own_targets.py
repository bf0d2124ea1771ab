"""Networks of one's own in the real stack and on the command line, beside a folder that is no good."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.conftest import Stack, serving
from tests.integration.specs import scene
from tests.unit.targets.custom.small_network import LABELS, folder, save_onnx, save_pt2

pytestmark = pytest.mark.integration

ON_PIXELS = {"renderer": "image", "base_renderer": "pyrender", "method": "fgsm", "steps": 40}


@pytest.fixture(scope="module")
def mine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A program, the same as ONNX, a folder without a card, and a program whose labels do not fit."""
    root = tmp_path_factory.mktemp("mine")
    save_pt2(folder(root, "program") / "model.pt2")
    save_onnx(folder(root, "onnx") / "model.onnx")
    (root / "empty").mkdir()
    save_pt2(folder(root, "short", labels=LABELS[:3]) / "model.pt2")
    return root


@pytest.fixture(scope="module")
def stack(mine: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    with serving(tmp_path_factory.mktemp("own") / "data", SCENE_ATTACK_TARGETS=str(mine)) as found:
        yield found


def test_the_service_says_what_it_found(stack: Stack) -> None:
    folders = {one["name"]: one for one in stack.client.get("/readyz").json()["targets"]}
    assert {name: one["error"] is None for name, one in folders.items()} == {
        "program": True, "onnx": True, "short": True, "empty": False,
    }  # fmt: skip
    assert folders["empty"]["error"].startswith("card.json: there is no such file")
    listed = {one["name"]: one for one in stack.client.get("/v1/targets").json()["items"]}
    assert listed["program"]["card_sha256"] == folders["program"]["card_sha256"]
    assert (listed["program"]["differentiable"], listed["onnx"]["differentiable"]) == (True, False)
    assert "empty" not in listed


def test_the_same_network_gives_the_same_adversary_in_both_formats(stack: Stack) -> None:
    attack = {"renderer": "image", "base_renderer": "pyrender", "method": "square", "epsilon": {"image": 0.3}}
    jobs = [
        stack.ended(stack.submit({"scene": scene(48), "target": {"name": name}, "attack": attack}))
        for name in ("program", "onnx")
    ]
    for job in jobs:
        assert job["state"] == "succeeded", job["failure"]
        assert job["outcome"]["verified"]
    one, two = (job["outcome"] for job in jobs)
    assert (one["before"], one["after"], one["steps"]) == (two["before"], two["after"], two["steps"])
    assert one["after_confidence"] == pytest.approx(two["after_confidence"], abs=1e-4)
    provenance = [job["result"]["provenance"] for job in jobs]
    assert provenance[0]["weights_sha256"] != provenance[1]["weights_sha256"]
    assert provenance[0]["card_sha256"] == provenance[1]["card_sha256"]


@pytest.mark.parametrize(
    ("name", "said"), [("empty", "is not available: card.json: there is no such file"), ("short", "[2, 3] is due")]
)
def test_a_network_that_cannot_be_used_is_refused_before_anything_is_queued(stack: Stack, name: str, said: str) -> None:
    answer = stack.client.post("/v1/jobs", json={"scene": scene(48), "target": {"name": name}, "attack": ON_PIXELS})
    assert answer.status_code == 422
    assert said in json.dumps(answer.json(), ensure_ascii=False)
    assert "target.name" in answer.text
    assert not [job for job in stack.client.get("/v1/jobs").json()["items"] if job["target"] == name]


def check(mine: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    environ = os.environ | {"SCENE_ATTACK_TARGETS": str(mine)}
    command = [sys.executable, "-m", "client", "targets", "check", *arguments, "--mesh", "primitive/sphere"]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environ)


def test_the_command_line_tries_one(mine: Path) -> None:
    done = check(mine, "onnx", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert not found["gradient"]
    assert "torch.export.save" in found["no_gradient"]
    assert {answer["label"] for answer in found["answers"]} == set(LABELS)
    assert "target left out" not in done.stderr
    done = check(mine, "short")
    assert done.returncode == 2
    assert "bad input: target.name: target 'short' returns torch.float32 [2, 5]" in done.stderr
