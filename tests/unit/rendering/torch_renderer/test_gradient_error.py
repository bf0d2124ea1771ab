"""The gradient errors that a plan states, against those of whole images."""

import pytest
import torch
from torch import Tensor

from services.rendering.torch_renderer.declaration import TORCH
from services.rendering.torch_renderer.renderer import TorchRenderer
from tests.unit.rendering.torch_renderer.planned import on_sphere

GROUPS = TORCH.group_names


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
        leaves = {group: value.requires_grad_() for group, value in one.initial().items()}
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
