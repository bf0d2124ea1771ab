"""The derivative written by hand, where it is cut, and when it is made of pieces."""

from math import log

import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from scene_attack.rendering.torch import shading
from scene_attack.rendering.torch.dsbrdf import half_vectors
from scene_attack.rendering.torch.shading import Directions

pytestmark = pytest.mark.usefixtures("kernel")

VIEWER = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)


def inputs(pixels=7, directions=6, log_kappa=0.0) -> tuple[Tensor, ...]:
    rng = torch.Generator().manual_seed(0)

    def noise(*shape: int) -> Tensor:
        return torch.randn(*shape, dtype=torch.float64, generator=rng)

    normals = normalize(noise(pixels, 3) * 0.5 + VIEWER, dim=-1)
    towards = normalize(noise(directions, 3), dim=-1)
    half, _ = half_vectors(towards, VIEWER)
    kappa, gamma = noise(3, 3, directions) + log_kappa, noise(3, 3, directions).exp()
    base, tilt = noise(3, directions).exp(), noise(3, directions)
    there = Directions.of(towards, half)
    return normals, noise(3, directions).exp(), kappa, gamma, base, tilt, there.towards, there.half


def radiance(*values: Tensor) -> Tensor:
    normals, light, log_kappa, gamma, base, tilt, towards, half = values
    lobes = shading.Lobes(base, tilt, log_kappa, gamma)
    return shading.radiance(normals, light, lobes, Directions(towards, half))


def leaves(values: tuple[Tensor, ...]) -> list[Tensor]:
    return [v.clone().requires_grad_(i < 4) for i, v in enumerate(values)]


@pytest.mark.parametrize("log_kappa", [-3.0, 0.0, 2.5])
def test_gradcheck(log_kappa: float) -> None:
    """At 2.5 about a third of the lobes are cut off at ρ = exp(20)."""
    values = inputs(log_kappa=log_kappa)
    size = radiance(*values).abs().max()
    assert torch.autograd.gradcheck(lambda n, *v: radiance(normalize(n, dim=-1), *v) / size, leaves(values))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_lobe_that_is_cut_off_has_no_slope(dtype: torch.dtype) -> None:
    normals, light, kappa, gamma, *others = (v.to(dtype) for v in inputs())
    kappa[:, 1], gamma[:, 1] = log(1e4), 1e-3
    lobes = leaves((normals, light, kappa, gamma, *others))
    d_kappa, d_gamma = torch.autograd.grad(radiance(*lobes).sum(), lobes[2:4])
    assert (d_kappa[:, 1] == 0).all()
    assert (d_gamma[:, 1] == 0).all()
    assert (d_kappa[:, 0] != 0).any()


def test_pieces_make_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    values = leaves(inputs(pixels=50))
    weights = torch.randn(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    whole = radiance(*values)
    slopes = torch.autograd.grad((whole * weights).sum(), values[:4])
    monkeypatch.setattr(shading, "CHUNK", 1)  # 16 pixels at once, the last piece short
    pieces = radiance(*values)
    torch.testing.assert_close(pieces, whole, rtol=1e-12, atol=0)
    for one, other in zip(torch.autograd.grad((pieces * weights).sum(), values[:4]), slopes, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("wanted", range(4))
def test_one_gradient_alone_is_the_same(wanted: int) -> None:
    """What is not asked for is left out; what is asked for does not notice."""
    values = inputs()
    everything = leaves(values)
    slopes = torch.autograd.grad(radiance(*everything).sum(), everything[:4])
    alone = [v.clone().requires_grad_(i == wanted) for i, v in enumerate(values)]
    assert torch.equal(torch.autograd.grad(radiance(*alone).sum(), alone[wanted])[0], slopes[wanted])


def test_dim_lobes_keep_their_digits() -> None:
    """exp(x) − 1 in float32 is 0 for x = 1e-8, expm1 is not."""
    values = inputs(log_kappa=log(1e-8))
    values = (*values[:4], *(torch.zeros_like(v) for v in values[4:6]), *values[6:])
    exact = radiance(*values)
    assert exact.max() < 1e-4
    torch.testing.assert_close(radiance(*(v.float() for v in values)).double(), exact, rtol=1e-5, atol=0)


def test_no_pixels() -> None:
    values = leaves(inputs(pixels=0))
    assert radiance(*values).shape == (0, 3)
    assert all((g == 0).all() for g in torch.autograd.grad(radiance(*values).sum(), values[:4]))
