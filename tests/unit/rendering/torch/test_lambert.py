"""The sum of surfaces that reflect alike in every direction: against its terms one by one, and against autograd."""

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from scene_attack.rendering.torch import dsbrdf, shading
from scene_attack.rendering.torch.dsbrdf import MATERIAL_UNIT, preset

pytestmark = pytest.mark.usefixtures("kernel")


def inputs(pixels: int = 41, directions: int = 29) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Normals, light, directions to it, and visibility."""
    random = torch.Generator().manual_seed(0)

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=random)

    seen = torch.randint(0, 256, (directions, pixels), generator=random, dtype=torch.uint8)
    towards = normalize(noise(directions, 3), dim=-1).T.contiguous()
    return normalize(noise(pixels, 3), dim=-1), noise(3, directions).exp(), towards, seen


def plain(normals: Tensor, light: Tensor, towards: Tensor, seen: Tensor | None) -> Tensor:
    share = 1.0 if seen is None else seen.T.double() / 255
    return ((normals @ towards).clamp_min(0.0) * share) @ light.T


@pytest.mark.parametrize("shadows", [False, True])
def test_sum_and_gradients_are_those_of_the_formula(shadows: bool) -> None:
    normals, light, towards, seen = inputs()
    hidden = seen if shadows else None
    weights = torch.randn(41, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = []
    for function in (shading.lambert_radiance, plain):
        leaves = [normals.clone().requires_grad_(), light.clone().requires_grad_()]
        value = function(*leaves, towards, hidden)
        found.append((value.detach(), *torch.autograd.grad((value * weights).sum(), leaves)))
    for own, truth in zip(*found, strict=True):
        assert float((own - truth).abs().max()) < 1e-12


def test_single_precision_is_near_double() -> None:
    normals, light, towards, seen = inputs(pixels=1500)
    own = shading.lambert_radiance(normals.float(), light.float(), towards.float(), seen)
    assert float((own.double() - plain(normals, light, towards, seen)).abs().max()) < 1e-5 * float(light.sum())


def test_only_matte_reflects_alike_in_every_direction() -> None:
    unit = [preset(name, "material") * MATERIAL_UNIT for name in ("matte", "rubber", "metal", "plastic")]
    found = [shading.albedo(material) for material in unit]
    assert [value is None for value in found] == [False, True, True, True]
    matte = found[0]
    assert matte is not None
    # Its reflectance in the direction of the light, and at a half angle of 60 degrees.
    curves = dsbrdf.basis(torch.tensor([0.3], dtype=torch.float64))
    for cosine in (1.0, 0.5):
        log_cosine = torch.tensor(cosine, dtype=torch.float64).log()
        rho = dsbrdf.reflectance(log_cosine, *dsbrdf.lobes(unit[0] / MATERIAL_UNIT, curves)).sum((1, 2))
        assert matte.tolist() == pytest.approx(rho.tolist(), rel=1e-3)
