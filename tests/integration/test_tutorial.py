"""The commands of docs/tutorial.md, run in order on a mesh and a network of the test's own."""

import os
import re
import subprocess
import sys
from pathlib import Path

import PIL.Image
import pytest
import trimesh

from tests.integration.conftest import serving

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "tutorial.md").read_text("utf-8")
SHELL = re.findall(r'^```sh title="(\d)"\n(.*?)^```$', PAGE, re.M | re.S)
PYTHON = dict(re.findall(r'^```python title="(\w+\.py)"\n(.*?)^```$', PAGE, re.M | re.S))
NETWORK = """
import torch
from torch import nn

LABELS = ["mug", "bowl", "vase", "jug"]


def network():
    torch.manual_seed(0)
    layers = [nn.Conv2d(3, 16, 5, 4), nn.ReLU(), nn.AdaptiveAvgPool2d(2), nn.Flatten(), nn.Linear(64, 4)]
    return nn.Sequential(*layers)
"""


def test_the_page_has_its_steps() -> None:
    assert [number for number, _ in SHELL] == list("123456")
    assert set(PYTHON) == {"export.py", "finding.py"}


def test_the_tutorial_leads_to_a_finding(tmp_path: Path) -> None:
    folder = tmp_path / "reader"
    commands = folder / "bin"
    commands.mkdir(parents=True)
    for name, module in (("scene-attack", "-m scene_attack"), ("python", "")):
        (commands / name).write_text(f'#!/bin/sh\nexec {sys.executable} {module} "$@"\n')
        (commands / name).chmod(0o755)
    for name, code in (PYTHON | {"mine.py": NETWORK}).items():
        (folder / name).write_text(code)
    mug = trimesh.creation.cylinder(radius=0.4, height=1.0)
    (folder / "mug.obj").write_text(mug.export(file_type="obj"))

    def run(steps: str, **environ: str) -> "subprocess.CompletedProcess[str]":
        path = f"{commands}:{os.environ['PATH']}"
        about = os.environ | {"PATH": path, "PYTHONPATH": f"{ROOT}:{folder}", **environ}
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", steps],
            cwd=folder,
            env=about,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done

    first, *others = (text for _, text in SHELL)
    assert "mine" in run(first).stdout
    with serving(tmp_path / "data", SCENE_ATTACK_TARGETS=str(folder / "networks")) as stack:
        about = {
            "SCENE_ATTACK_TARGETS": str(folder / "networks"),
            "SCENE_ATTACK_URL": str(stack.client.base_url),
            "SCENE_ATTACK_DATA": str(stack.data),
        }
        done = run("".join(others), **about)
    assert "Subsets of the groups" in done.stdout
    assert re.search(r"^surface of .*: dented by \d.* % of its size in the root mean square", done.stdout, re.M)
    assert re.search(r"^bump \+ lamp (mug|bowl|vase|jug) p = 0\.\d{4}$", done.stdout, re.M)
    with PIL.Image.open(folder / "attacked.png") as attacked:
        assert attacked.size == (128, 128)
    assert (folder / "out/mug/attacked.png").is_file()
