"""A network of the process that is saved as a folder, and loaded by its name in a process of its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import nn

import scene_attack as sa

pytestmark = pytest.mark.slow
LOAD = """
import sys, torch, scene_attack as sa
from scene_attack.runs.environment import options_to_run
from scene_attack.targets.registry import load

options_to_run()
target = load("mine")
assert target.labels == ("a", "b", "c"), target.labels
torch.save(target.logits(torch.load(sys.argv[1])).detach(), sys.argv[2])
"""


def network() -> nn.Module:
    torch.manual_seed(1)
    layers = [nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4), nn.ReLU(), nn.Dropout(), nn.AdaptiveAvgPool2d(1), nn.Flatten()]
    return nn.Sequential(*layers, nn.Linear(4, 3))


def test_it_gives_the_same_scores(tmp_path: Path) -> None:
    preprocessing = {"input_size": [8, 10], "mean": [0.1, 0.2, 0.3], "std": [0.5, 0.6, 0.7], "channels": "bgr"}
    target = sa.target(network(), labels=["a", "b", "c"], preprocessing=preprocessing)
    target.save(tmp_path / "targets" / "mine")  # type: ignore[attr-defined]
    images = torch.rand(3, 16, 16, 3)
    torch.save(images, tmp_path / "images")
    command = [sys.executable, "-P", "-c", LOAD, str(tmp_path / "images"), str(tmp_path / "scores")]
    environment = os.environ | {"SCENE_ATTACK_TARGETS": str(tmp_path / "targets")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    torch.testing.assert_close(torch.load(tmp_path / "scores"), target.logits(images), rtol=1e-5, atol=1e-6)
    with pytest.raises(sa.InvalidRequest, match="name a new folder"):
        target.save(tmp_path / "targets" / "mine")  # type: ignore[attr-defined]


class Branching(nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x.mean((2, 3)) if x.sum() > 0 else x.amax((2, 3))


def test_what_cannot_be_saved_is_refused(tmp_path: Path) -> None:
    small = {"input_size": [8, 8]}
    refusals = [
        (sa.target(lambda x: network()(x), preprocessing=small), "mine", "target", "only a torch module can"),
        (sa.target(Branching(), preprocessing=small), "mine", "target", "torch.export cannot write it"),
        (sa.target(network(), preprocessing=small), "My Net", "folder", "'My Net' is to be the network's name"),
    ]
    for target, name, field, said in refusals:
        with pytest.raises(sa.InvalidRequest, match=said) as refused:
            target.save(tmp_path / name)  # type: ignore[attr-defined]
        assert refused.value.field == field
    assert not (tmp_path / "mine").exists()


def test_options_that_are_passed_decide_what_a_folder_may_name(tmp_path: Path) -> None:
    """Not those of the environment, which name nothing."""
    (tmp_path / "mine").mkdir()
    card = {"labels": ["a", "b"], "preprocessing": {"input_size": [8, 8]}, "factory": "own_factory:network"}
    (tmp_path / "mine" / "card.json").write_text(json.dumps(card))
    (tmp_path / "own_factory.py").write_text(
        "import torch\n\n\ndef network():\n    torch.manual_seed(0)\n"
        "    return torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(192, 2))\n"
    )
    code = (
        "from pathlib import Path\nimport scene_attack as sa\n"
        "scene = sa.Scene(camera=sa.Camera(size=(16, 16)), objects=[sa.Object(mesh='primitive/cube')])\n"
        "options = sa.Options(target_factories='own_factory:network')\n"
        "search = {'renderer': 'image', 'base_renderer': 'pyrender', 'method': 'square', 'steps': 2}\n"
        "print(sa.attack(scene, Path('mine'), search, options=options).record.spec['target']['name'])\n"
    )
    environ = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environ, capture_output=True, text=True, check=False
    )
    assert done.stdout == "mine\n", done.stderr
