"""The gradient errors that a plan states, against those of whole images."""

import pytest
import torch
from torch import Tensor

from scene_attack.rendering.torch.dsbrdf import MATERIAL_UNIT, preset
from scene_attack.rendering.torch.light import illumination
from scene_attack.rendering.torch.planner import gradient_errors
from scene_attack.rendering.torch.renderer import TorchRenderer, sky_of
from scene_attack.rendering.torch.shader import Recipe, Surface
from tests.unit.rendering.shading import sky
from tests.unit.rendering.torch.planned import on_sphere

GROUPS = ("normals", "illumination", "illumination_rgb", "material")  # into which others are turned


@pytest.fixture(scope="module")
def renderer() -> TorchRenderer:
    """A coarse table, under which the gradients of normals, light and material are off by 6e-2, 6e-3 and 7e-4."""
    return on_sphere(GROUPS, tolerance=1e-1, size=96, materials=("matte",))


@pytest.fixture(scope="module")
def of_images(renderer: TorchRenderer) -> list[tuple[Tensor, Tensor]]:
    """By group, the gradients of the same random weights on all pixels: the renderer's, and the exact renderer's."""
    random = torch.Generator().manual_seed(7)
    weights = torch.randn(*renderer.size, 3, generator=random, dtype=torch.float64)
    found = []
    for one in (renderer, renderer.exact()):
        leaves = {group: one.initial()[group].requires_grad_() for group in GROUPS}
        image = one.render({group: value[None] for group, value in leaves.items()})[0]
        total = (image * weights.to(image.dtype)).sum()
        found.append([gradient.double() for gradient in torch.autograd.grad(total, [leaves[g] for g in GROUPS])])
    return list(zip(*found, strict=True))


def test_each_group_s_error_is_its_own(renderer: TorchRenderer, of_images: list[tuple[Tensor, Tensor]]) -> None:
    """Within a factor of two: the plan measures 512 pixels and moved copies of them, with weights of its own."""
    assert tuple(one.group for one in renderer.plan.gradients) == GROUPS
    stated = [one.relative for one in renderer.plan.gradients]
    measured = [float((own - exact).norm() / exact.norm()) for own, exact in of_images]
    assert measured == pytest.approx([6e-2, 6e-3, 6e-3, 7e-4], rel=0.5)  # the two of light are alike
    for value, true in zip(stated, measured, strict=True):
        assert true / 2 < value < 2 * true


def test_wrong_signs_are_a_share_of_the_coordinates(
    renderer: TorchRenderer, of_images: list[tuple[Tensor, Tensor]]
) -> None:
    own, exact = of_images[0]
    there = exact != 0
    wrong = float(((own.sign() != exact.sign()) & there).sum() / there.sum())
    assert wrong > 1e-3
    assert wrong / 1.7 < renderer.plan.gradients[0].wrong_signs < 1.7 * wrong


def test_a_gradient_that_vanishes_in_float32_has_the_wrong_sign() -> None:
    """Every other pixel has a base colour of 1e-60, which is 0 in float32. Its gradient is 0 there and not in float64,
    so half of the signs are wrong, and the few that float32 rounds to the other side."""
    light = illumination(torch.as_tensor(sky()))
    random = torch.Generator().manual_seed(3)
    angles = (torch.rand(20, 2, generator=random, dtype=torch.float64) - 0.5).repeat_interleave(2, dim=0)
    colors = torch.tensor([[0.2] * 3, [1e-60] * 3], dtype=torch.float64).repeat(20, 1)
    surface = Surface("", angles, colors, preset("matte", "material") * MATERIAL_UNIT)
    every = torch.ones(surface.material.shape[:2], dtype=torch.bool)
    recipes = [
        Recipe(torch.arange(32), False, every, ~every, "summed", moving=True, dtype=dtype)
        for dtype in (torch.float32, torch.float64)
    ]
    own_sky = sky_of(light, torch.eye(3, dtype=torch.float64))
    [found] = gradient_errors(surface, own_sky, light.intensity.flatten(), ("normals",), *recipes)
    assert found.wrong_signs == pytest.approx(0.5, abs=0.02)
