"""`scene-attack run` on every example: its files, the same bits twice, the same image from its perturbation."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from services.pipeline.execute import execute
from services.pipeline.spec import parse
from services.rendering.torch_renderer.declaration import TORCH
from services.scenes.library import Library
from services.settings import Settings

pytestmark = pytest.mark.integration

EXAMPLES = {
    path.stem: path
    for path in sorted((Path(__file__).parents[2] / "examples").glob("*.json"))
    if {"scene", "generate"} & json.loads(path.read_text()).keys()
}
"""Requests of one job, not of a campaign."""
SIZE = 96
FEW = {"delta": 1e-2, "coordinates": 8}
"""Settings of ZOO with which it asks the network a tenth of its questions."""
FILES = ["attacked.png", "original.png", "perturbation.png", "perturbation.safetensors", "result.json", "trace.json"]


def small(name: str) -> dict[str, Any]:
    """The example with few steps and, if it asks no question, a small image; so small, the network's first answer may
    be another. Questions keep their image, as several are refused if the first answer to one is wrong.
    """
    spec: dict[str, Any] = json.loads(EXAMPLES[name].read_text())
    spec["attack"]["steps"] = 2
    if "scene" in spec:
        spec["scene"].setdefault("camera", {})["size"] = [SIZE, SIZE]
        spec["goal"].pop("leave")
    return spec


def cli(*arguments: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "client", *arguments],
        input=stdin,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def test_there_is_an_example_for_every_renderer_and_task() -> None:
    specs = [parse(json.loads(path.read_text())) for path in EXAMPLES.values()]
    assert {spec.attack.renderer for spec in specs} == {"image", "pyrender", "torch"}
    attacked = {(spec.attack.renderer, spec.attack.groups) for spec in specs}
    assert {("torch", (group,)) for group in TORCH.default_groups} < attacked
    assert ("torch", TORCH.default_groups) in attacked
    assert any(spec.goal.reach is not None for spec in specs)
    assert {spec.attack.method for spec in specs} == {"fgsm", "zoo", "natural-gradient"}
    asking = {spec.attack.renderer for spec in specs if spec.target.asked or spec.target.questions}
    assert asking == {"pyrender", "torch"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_writes_its_files_and_two_processes_find_the_same_bits(name: str, tmp_path: Path) -> None:
    spec = small(name)
    done = cli("run", "-", "--out", str(tmp_path / "one"), stdin=json.dumps(spec))
    assert done.returncode == 0, done.stderr
    written = sorted(path.name for path in (tmp_path / "one").iterdir())
    attention = [name for name in written if name.startswith("attention")]
    drawn = [name for name in written if name.startswith(("map-", "normals-"))]
    subsets = [name for name in written if name.startswith("subset")]
    assert [name for name in written if name not in (*attention, *subsets, *drawn)] == FILES
    assert len(subsets) == max(0, 2 ** len(parse(spec).attack.groups) - 2)
    assert bool(attention) == ("Questions about the image" in done.stdout) == ("generate" in spec)
    threads = torch.get_num_threads()
    torch.set_num_threads(Settings().threads)  # part of what decides the bits
    try:
        execute(parse(spec), tmp_path / "two", Library(Settings().cache_dir, Settings().data_dir))
    finally:
        torch.set_num_threads(threads)
    for file in (*FILES[:4], *attention):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), file
    first, second = (json.loads((tmp_path / run / "result.json").read_text()) for run in ("one", "two"))
    for result in (first, second):  # time is the one thing that may differ
        result.pop("seconds")
        for row in result["trace"]:
            row.pop("seconds")
    assert first == second


def test_replay_reproduces_a_result_and_sees_a_damaged_one(tmp_path: Path) -> None:
    out = tmp_path / "out"
    spec = small("pyrender-zoo")
    spec["attack"] |= FEW
    assert cli("run", "-", "--out", str(out), stdin=json.dumps(spec)).returncode == 0
    again = cli("replay", str(out), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["pixels_differing"] == 0
    (out / "attacked.png").write_bytes((out / "perturbation.png").read_bytes())
    wrong = cli("replay", str(out), "--json")
    assert wrong.returncode == 1
    assert json.loads(wrong.stdout)["pixels_differing"] > 0
    (out / "perturbation.safetensors").unlink()
    missing = cli("replay", str(out))
    assert missing.returncode == 2
    assert "perturbation.safetensors" in missing.stderr


def test_a_run_that_was_killed_goes_on_to_the_same_end(tmp_path: Path) -> None:
    spec = small("pyrender-zoo")
    spec["attack"] |= FEW | {"steps": 40}
    file = tmp_path / "spec.json"
    file.write_text(json.dumps(spec))
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert cli("run", str(file), "--out", str(whole)).returncode == 0
    begun = subprocess.Popen([sys.executable, "-m", "client", "run", str(file), "--out", str(broken)])
    while not (broken / "checkpoint").exists():
        assert begun.poll() is None, "it ended before its first checkpoint"
        os.sched_yield()
    begun.send_signal(signal.SIGKILL)
    begun.wait()
    assert not (broken / "result.json").exists()
    resumed = cli("run", str(file), "--out", str(broken))
    assert resumed.returncode == 0, resumed.stderr
    kept = sorted(path.name for path in broken.iterdir())
    assert [name for name in kept if not name.startswith("subset")] == FILES
    for name in FILES[:4]:
        assert (whole / name).read_bytes() == (broken / name).read_bytes(), name


def test_a_bad_scene_exits_2_and_leaves_nothing(tmp_path: Path) -> None:
    spec = small("image-fgsm")
    spec["scene"]["objects"][0]["mesh"] = "furniture/soccer-bal"
    done = cli("run", "-", "--out", str(tmp_path / "out"), stdin=json.dumps(spec))
    assert done.returncode == 2
    assert "scene.objects.0.mesh" in done.stderr
    assert "furniture/soccer-ball" in done.stderr
    assert not (tmp_path / "out").exists()
