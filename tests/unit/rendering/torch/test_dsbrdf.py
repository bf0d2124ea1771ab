from math import log, pi

import numpy as np
import pytest
import torch

from scene_attack.rendering.torch import dsbrdf
from scene_attack.rendering.torch.dsbrdf import basis, half_vectors, lobes, reflectance
from tests.unit.rendering.shading import reference_brdf

D64 = torch.float64


def brdf(material: torch.Tensor, theta_h: torch.Tensor, theta_d: torch.Tensor) -> torch.Tensor:
    """ρ [channels, N]."""
    log_kappa, gamma = lobes(material, basis(theta_d))
    return reflectance(theta_h.cos().clamp_min(dsbrdf.COSINE_FLOOR).log(), log_kappa, gamma).sum(1)


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-12), (torch.float32, 1e-5)])
def test_against_the_formula(dtype: torch.dtype, tolerance: float) -> None:
    rng = np.random.default_rng(0)
    theta_h, theta_d = rng.uniform(0, 1.5, 200), rng.uniform(0, pi / 2, 200)
    material = rng.normal(size=dsbrdf.SHAPE) * 0.7
    material[:, 2] += [[1.0], [3.0]]  # one lobe high and narrow
    found = brdf(torch.tensor(material, dtype=dtype), torch.tensor(theta_h).to(dtype), torch.tensor(theta_d).to(dtype))
    for c in range(3):
        wanted = [reference_brdf(material[c], h, d) for h, d in zip(theta_h, theta_d, strict=True)]
        np.testing.assert_allclose(found[c].double().numpy(), wanted, rtol=tolerance)


def test_basis_is_positive_and_sums_to_one() -> None:
    curves = basis(torch.linspace(0, pi / 2, 50, dtype=D64))
    assert (curves >= 0).all()
    torch.testing.assert_close(curves.sum(-1), torch.ones(50, dtype=D64), rtol=1e-14, atol=0)
    assert curves[0].tolist() == [1, 0, 0, 0, 0, 0]
    assert curves[-1].tolist() == [0, 0, 0, 0, 0, 1]


def test_half_vectors() -> None:
    rng = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(500, 3, dtype=D64, generator=rng), dim=-1)
    viewer = torch.tensor([0.0, 0.0, 1.0], dtype=D64)
    half, theta_d = half_vectors(directions, viewer)
    torch.testing.assert_close(torch.linalg.vector_norm(half, dim=-1), torch.ones(500, dtype=D64))
    torch.testing.assert_close((half * directions).sum(-1), theta_d.cos())
    torch.testing.assert_close(half @ viewer, theta_d.cos())


def test_light_from_behind_has_no_half_vector() -> None:
    viewer = torch.tensor([0.6, 0.0, 0.8], dtype=D64)
    half, theta_d = half_vectors(torch.stack((-viewer, viewer)), viewer)
    assert half[0].tolist() == [0, 0, 0]
    assert theta_d.tolist() == pytest.approx([pi / 2, 0])
    torch.testing.assert_close(half[1], viewer)


def test_small_lobes_keep_their_digits() -> None:
    """exp(x) − 1 in float32 is 0 for x = 1e-8, expm1 is not."""
    found = reflectance(torch.zeros(1), torch.tensor([log(1e-8)]), torch.ones(1))
    assert float(found) == pytest.approx(1e-8, rel=1e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("log_kappa", [-1e4, -80.0, log(1e4), 1e4])
@pytest.mark.parametrize("log_gamma", [-1e4, log(1e-3), log(1e5), 1e4])
def test_extremes_stay_finite(dtype: torch.dtype, log_kappa: float, log_gamma: float) -> None:
    material = torch.empty(1, 1, 2, 6, dtype=dtype)
    material[..., 0, :], material[..., 1, :] = log_kappa, log_gamma
    material.requires_grad_()
    cosine = torch.tensor([0.0, 1e-5, 1e-3, 0.5, 0.999, 1.0], dtype=dtype, requires_grad=True)
    kappa, gamma = lobes(material, basis(torch.full((6,), 0.7, dtype=dtype)))
    rho = reflectance(cosine.clamp_min(dsbrdf.COSINE_FLOOR).log(), kappa, gamma)
    gradients = torch.autograd.grad(rho.sum(), (material, cosine))
    assert rho.isfinite().all()
    assert (rho >= 0).all()
    assert all(g.isfinite().all() for g in gradients)
