"""`scene-attack run` with every example and attack: its files, its counts, the same bits in another process."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.runs.spec import parse
from tests.integration.conftest import until
from tests.integration.specs import long
from tests.unit.client.command_line import cli, process

pytestmark = pytest.mark.integration

EXAMPLES = {
    path.stem: path
    for path in sorted((Path(__file__).parents[2] / "examples").glob("*.json"))
    if "scene" in json.loads(path.read_text())
}
"""Requests of one job, not of a campaign."""
SIZE = 64
FEW = {"delta": 1e-2, "coordinates": 8}
"""Settings of ZOO with which it asks the network a tenth of its questions."""
TWICE = {"image-fgsm", "pyrender-zoo", "torch-combined"}
"""Examples that are run in another process, too: one of each renderer."""
FILES = ["attacked.png", "original.png", "perturbation.png", "perturbation.safetensors", "result.json", "trace.json"]
SCENE = {
    "objects": [{"mesh": "furniture/soccer-ball"}],
    "camera": {"size": [96, 96]},
    "lights": {"environment": {"size": [8, 16]}},
}
PIXELS = {"renderer": "image", "base_renderer": "pyrender"}
ATTACKS: dict[str, tuple[dict[str, Any], int]] = {
    "mi-fgsm": ({"groups": ["normals"], "truncation": 6, "constraint": "backtrack", "steps": 2}, 1),
    "apgd": ({"groups": ["normals", "illumination"], "loss": "dlr", "steps": 3, "restarts": 1}, 1),
    "cma-es": ({"renderer": "pyrender", "groups": ["color", "illumination"], "population": 6, "steps": 2}, 7),
    "natural-gradient": ({"renderer": "pyrender", "steps": 3}, 1),
    "p-rgf": ({"renderer": "pyrender", "groups": ["color"], "steps": 2}, 9),
    "spsa": ({"renderer": "pyrender", "groups": ["rotation", "illumination"], "steps": 2}, 33),
    "square": (PIXELS | {"steps": 8}, 1),
}
"""The settings of each, and its queries a step."""


def small(name: str) -> dict[str, Any]:
    """The example with few steps and, if it asks no question, a small image; so small, the network's first answer may
    be another. Questions keep their image, as several are refused if the first answer to one is wrong.
    """
    spec: dict[str, Any] = json.loads(EXAMPLES[name].read_text())
    spec["attack"]["steps"] = 2
    if "ask" not in spec.get("target", {}):
        spec["scene"].setdefault("camera", {})["size"] = [SIZE, SIZE]
        spec["goal"].pop("leave")
    if spec["attack"].get("method") == "zoo":
        spec["attack"] |= FEW
    return spec


def test_there_is_an_example_for_every_renderer_and_task() -> None:
    specs = [parse(json.loads(path.read_text())) for path in EXAMPLES.values()]
    assert {spec.attack.renderer for spec in specs} == {"image", "pyrender", "sensor", "torch"}
    attacked = {(spec.attack.renderer, spec.attack.groups) for spec in specs}
    assert {("torch", (group,)) for group in TORCH.default_groups} < attacked
    assert ("torch", TORCH.default_groups) in attacked
    assert any(spec.goal.reach is not None for spec in specs)
    assert {spec.attack.method for spec in specs} == {"fgsm", "zoo", "natural-gradient"}
    asking = {spec.attack.renderer for spec in specs if spec.target.ask is not None}
    assert asking == {"pyrender", "torch"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_writes_its_files_and_another_process_finds_the_same_bits(name: str, tmp_path: Path) -> None:
    spec = small(name)
    done = cli("run", "-", "--out", str(tmp_path / "one"), stdin=json.dumps(spec))
    assert done.returncode == 0, done.stderr
    written = sorted(path.name for path in (tmp_path / "one").iterdir())
    attention = [name for name in written if name.startswith("attention")]
    drawn = [name for name in written if name.startswith(("map-", "normals-", "dents", "paint", "shape"))]
    subsets = [name for name in written if name.startswith("subset")]
    assert [name for name in written if name not in (*attention, *subsets, *drawn)] == FILES
    assert len(subsets) == max(0, 2 ** len(parse(spec).attack.groups) - 2)
    assert bool(attention) == ("Questions about the image" in done.stdout) == ("source" in spec["scene"])
    if name not in TWICE:
        return
    other = process("run", "-", "--out", str(tmp_path / "two"), stdin=json.dumps(spec))
    assert other.returncode == 0, other.stderr
    for file in (*FILES[:4], *attention):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes(), file
    first, second = (json.loads((tmp_path / run / "result.json").read_text()) for run in ("one", "two"))
    for result in (first, second):  # time is the one thing that may differ
        result["cost"].pop("seconds")
        for row in result["trace"]:
            row.pop("seconds")
    assert first == second


@pytest.mark.parametrize("method", ATTACKS)
def test_an_attack_runs_on_furniture(method: str, tmp_path: Path) -> None:
    settings, per_step = ATTACKS[method]
    spec = {"scene": SCENE, "attack": settings | {"method": method}}
    done = cli("run", "-", "--out", str(tmp_path / "out"), stdin=json.dumps(spec))
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    rows = result["trace"]
    assert rows[0]["distance"] == 0
    assert min(row["advantage"] for row in rows) < rows[0]["advantage"]
    asked = [after["queries"] - before["queries"] for before, after in pairwise(rows)]
    verified = [before["advantage"] < 0 for before in rows[:-1]]  # such an image is asked for once more
    if method != "apgd":  # whose restart begins with a row that follows no step
        assert asked == [per_step + again for again in verified]
    assert result["verdict"]["stopped"] == "verified" or rows[-1]["restart"] == settings.get("restarts", 0)
    if settings.get("constraint") == "backtrack":
        assert result["change"]["beyond_truncation"] == 0


def test_replay_reproduces_a_result_and_sees_a_damaged_one(tmp_path: Path) -> None:
    out = tmp_path / "out"
    spec = small("pyrender-zoo")
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
    file = tmp_path / "spec.json"
    file.write_text(json.dumps(long(150)))  # several seconds, and a checkpoint is written every two
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert cli("run", str(file), "--out", str(whole)).returncode == 0
    begun = subprocess.Popen([sys.executable, "-m", "scene_attack", "run", str(file), "--out", str(broken)])
    until(lambda: (broken / "checkpoint").exists() or begun.poll() is not None, "a checkpoint")
    begun.kill()
    begun.wait()
    assert not (broken / "result.json").exists()
    resumed = cli("run", str(file), "--out", str(broken))
    assert resumed.returncode == 0, resumed.stderr
    assert sorted(path.name for path in broken.iterdir()) == FILES
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
