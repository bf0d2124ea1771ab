"""The derivation of docs/reports/materials.md: why a step of the paper's size moves the image as the paper says."""

import pytest
import torch

from scene_attack.rendering.torch.renderer import TorchRenderer
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene

U = 18 / 255
ONE_WAY = {"illumination": 1 / 3, "material": 1.0}
"""How much of the farthest move, all coordinates one way, must stay within U. Attacks on light mix their signs and move
the image far less than a uniform move would (docs/reports/materials.md)."""


def farthest(rate: float, steps: int = 120, momentum: float = 0.9) -> float:
    """How far signed steps with momentum come when every gradient has the same sign."""
    velocity = total = 0.0
    for _ in range(steps):
        velocity = momentum * velocity + 1
        total += rate * velocity
    return total


def test_farthest() -> None:
    assert farthest(0.003) == pytest.approx(3.33, abs=0.005)
    assert farthest(0.004, steps=4) == pytest.approx(0.036, abs=0.0005)


@pytest.mark.parametrize("group", ["illumination", "material"])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_uniform_move_stays_within_truncation_but_is_felt(group: str, sign: int) -> None:
    """White paint: all light, or all of κ and γ, moved one way. Units a tenth as large truncate it."""
    scene = sphere_scene((32, 32), sky(16, 32)[..., 1:2].repeat(3, axis=2), ("matte",))  # without colours
    renderer = TorchRenderer(scene, sphere_gbuffer(scene, albedo=(1, 1, 1)))
    before, start = renderer.render({}), renderer.initial()[group]
    change = {
        factor: (renderer.render({group: (start + sign * factor * ONE_WAY[group] * farthest(0.003))[None]}) - before)
        .abs()
        .amax(-1)
        for factor in (1, 10)
    }
    assert U / 3 < float(change[1].max()) < U
    covered = sphere_gbuffer(scene).coverage == 1
    assert (change[10][0][covered] > U).float().mean() > 0.5


def test_four_steps_on_the_normals_stay_within_truncation() -> None:
    """On white paint; the paper's attacks on normals end within a few steps."""
    scene = sphere_scene((32, 32), sky(16, 32), ("matte",))
    renderer = TorchRenderer(scene, sphere_gbuffer(scene, albedo=(1, 1, 1)))
    start = renderer.initial()["normals"]
    signs = torch.randn(start.shape, generator=torch.Generator().manual_seed(0)).sign()
    change = renderer.render({"normals": (start + signs * farthest(0.004, steps=4))[None]}) - renderer.render({})
    assert 0.005 < float(change.abs().max()) < U
