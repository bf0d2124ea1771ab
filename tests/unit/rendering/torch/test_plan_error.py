"""Images and gradients of a plan differ from the exact sum by no more than the plan says, and by no more than the
tolerance."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scene_attack.rendering.opengl.gbuffer import GBuffer
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN, presets
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering.shading import sphere_gbuffer, sphere_scene
from tests.unit.rendering.torch.planned import GROUPS, error, moved, on_sphere

pytestmark = pytest.mark.slow


@st.composite
def scenes(draw: st.DrawFn) -> tuple[ResolvedScene, GBuffer, tuple[str, ...]]:
    """A scene, its G-buffer and attacked groups: maps, materials, normals and sizes are random."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows, cols = draw(st.sampled_from([(1, 1), (2, 3), (4, 8), (8, 16), (16, 32), (24, 48)]))
    environment = np.exp(draw(st.floats(0, 3)) * rng.normal(size=(rows, cols, 3)))
    if draw(st.booleans()):
        environment[rng.integers(rows), rng.integers(cols)] *= 10 ** draw(st.floats(0, 6))
    if draw(st.booleans()):
        environment *= rng.random((rows, cols, 1)) < draw(st.floats(0.05, 1))
    size = draw(st.sampled_from([12, 24, 64, 96, 128]))
    materials = tuple(draw(st.lists(st.sampled_from(sorted(presets())), min_size=1, max_size=2)))
    scene = sphere_scene((size, size), environment.astype(np.float32), materials)
    gbuffer = sphere_gbuffer(scene, albedo=rng.random(3))
    rough = torch.tensor(rng.normal(size=(size, size, 3)) * draw(st.floats(0, 0.3)), dtype=torch.float32)
    normals = torch.nn.functional.normalize(gbuffer.normals + rough, dim=-1) * (gbuffer.coverage > 0)[..., None]
    still = [group for group in TORCH.group_names if group not in TORCH.moving_groups]
    chosen = draw(st.sets(st.sampled_from(still), min_size=1))
    groups = tuple(group for group in still if group in chosen)
    return scene, replace(gbuffer, normals=normals), groups


@given(scenes(), st.floats(0, 1), st.integers(0, 100))
@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_errors_are_within_estimate_and_tolerance(drawn: Any, far: float, seed: int) -> None:
    scene, gbuffer, groups = drawn
    renderer = TorchRenderer(scene, gbuffer, groups, 1e-3)
    start = {group: renderer.initial()[group][None] for group in groups}
    for parameters in (start, moved(renderer, groups, far, seed)):
        assert error(renderer, parameters) <= renderer.plan.error <= 1e-3


def test_a_scene_far_from_the_initial_one_falls_back_to_the_sum() -> None:
    """The table was measured without the sun. The check sees it, and the tolerance holds."""
    renderer = on_sphere(("normals", "illumination"), size=96)
    [shader] = renderer.shaders
    assert shader.recipe.rows is not None
    start = {g: renderer.initial()[g][None] for g in ("normals", "illumination")}
    assert error(renderer, start) <= renderer.plan.error
    assert shader.summed_after_all == 0
    start["illumination"][0, 6, 10] += 300 * ILLUMINATION_MEAN
    assert error(renderer, start) <= 1e-3
    assert shader.summed_after_all == 1
    shader.recipe = replace(shader.recipe, guard=None)
    assert error(renderer, start) > 1e-3  # without the check the tolerance would not hold


def test_a_plan_for_a_dark_scene_keeps_the_lobes_that_an_attack_lights() -> None:
    """The map is black at first. An attack turns the light on, and then every lobe is needed."""
    renderer = on_sphere(("normals", "illumination"), size=24, environment=np.zeros((4, 8, 3), np.float32))
    lit = moved(renderer, ("normals", "illumination"))
    assert renderer.render(lit).max() > 0.2
    assert error(renderer, lit) <= renderer.plan.error


@pytest.mark.parametrize(
    "groups", [("normals",), ("illumination",), ("illumination_rgb",), ("material",), GROUPS[:2], GROUPS[1:], GROUPS]
)
def test_gradients_are_those_of_the_exact_sum(groups: tuple[str, ...]) -> None:
    """They are weighted as an attack weights them: by a network's gradient, which is smooth over some pixels."""
    renderer = on_sphere(groups, size=128)
    assert renderer.shaders[0].recipe.rows is not None
    weights = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    weights = torch.nn.functional.interpolate(weights, (128, 128), mode="bicubic").permute(0, 2, 3, 1)
    gradients = []
    for one, dtype in ((renderer, torch.float32), (renderer.exact(), torch.float64)):
        leaves = {g: v.to(dtype).requires_grad_() for g, v in moved(renderer, groups, 0.1).items()}
        images = one.render(leaves)
        gradients.append(torch.autograd.grad((images * weights.to(dtype)).sum(), list(leaves.values())))
    for group, found, wanted in zip(groups, *gradients, strict=True):
        # Catmull-Rom's gradient is of one order less than its value; normals see it directly, the others through sums
        far = float((found.double() - wanted).norm() / wanted.norm())
        assert far < (0.05 if group == "normals" else 5e-3), group
        # FGSM uses the sign, which must be equal where rounding does not decide it
        large = wanted.abs() > 0.05 * wanted.abs().amax()
        assert torch.equal(found.sign()[large].double(), wanted.sign()[large]), group
