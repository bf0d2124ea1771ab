"""An attack with each kind of kernels, and with torch in their place, in a process of its own each."""

import json
import os
import subprocess
import sys

import pytest

from scene_attack.rendering.kernels import levels

pytestmark = pytest.mark.slow

ATTACK = """
import json
import torch
import scene_attack as sa

torch.manual_seed(0)
torch.set_num_threads(1)
layers = [torch.nn.Conv2d(3, 8, 3, 2), torch.nn.ReLU(), torch.nn.Flatten(), torch.nn.Linear(1800, 4)]
network = torch.nn.Sequential(*layers).requires_grad_(False).eval()
small = sa.Preprocessing(input_size=(32, 32))
target = sa.target(network, labels=list("abcd"), preprocessing=small)
scene = sa.Scene(camera=sa.Camera(size=(64, 64)), objects=[sa.Object(mesh="primitive/torus", material="plastic")])
attack = sa.FGSM(renderer="torch", groups=["normals", "illumination", "material"], steps=20)
result = sa.attack(scene, target, attack)
kinds = [item.what for item in result.plan.items]
print(json.dumps([result.perceptibility, result.verified, result.record.provenance.backend, kinds]))
"""


def attacked(kernels: str) -> tuple[float, bool, str, list[str]]:
    environ = os.environ | {"SCENE_ATTACK_KERNELS": kernels}
    done = subprocess.run(
        [sys.executable, "-P", "-c", ATTACK], env=environ, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    p, verified, backend, items = json.loads(done.stdout.splitlines()[-1])
    return p, verified, backend, items


def test_p_and_the_verdict_are_the_same_with_all_kernels_and_without() -> None:
    runnable = [level for level in levels.NEEDS if levels.refusal(level) is None]
    assert runnable
    results = {kernels: attacked(kernels) for kernels in [*runnable, "torch"]}
    p, verified, _, _ = results["torch"]
    assert p > 0
    for kernels, (other, verdict, backend, items) in results.items():
        assert verdict == verified
        # The loop computes in float32 and steps by signs: a gradient of one pixel that rounds to the other side of 0
        # would move that pixel by another step.
        assert other == pytest.approx(p, rel=1e-5)
        assert ("compiled kernels" in items) == (kernels == "torch")
        assert ("shading torch;" if kernels == "torch" else f"shading native {kernels} ") in backend
    native = [p for kernels, (p, *_) in results.items() if kernels != "torch"]
    # The order of all sums is that of the sources; only a product may or may not be fused with a sum.
    assert native == pytest.approx([native[0]] * len(native), rel=1e-6)
