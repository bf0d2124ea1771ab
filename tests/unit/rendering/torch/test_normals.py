from math import pi

import pytest
import torch

from scene_attack.rendering.torch.table import MAX_ANGLE, to_angles, to_vectors


def test_vectors_come_back() -> None:
    vectors = torch.nn.functional.normalize(
        torch.randn(1000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    # float64 rounding, times a few operations
    torch.testing.assert_close(to_vectors(to_angles(vectors)), vectors, rtol=0, atol=1e-14)


def test_float32_angles_lose_no_more_than_float32() -> None:
    vectors = torch.nn.functional.normalize(torch.randn(1000, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    torch.testing.assert_close(to_vectors(to_angles(vectors)), vectors, rtol=0, atol=5e-7)


def test_vectors_of_float32_angles_and_their_slopes_are_those_of_float64(kernel: str) -> None:
    random = torch.Generator().manual_seed(0)
    angles = (torch.rand(1001, 2, generator=random) * 2 - 1) * MAX_ANGLE
    # the quarter turns and what lies between, where one series hands over to the other; and far beyond any attack
    angles[:33] = torch.arange(-16, 17)[:, None] * (pi / 4)
    angles[33:36] = torch.tensor([[1e5, 0.5], [0.3, 2e6], [-3e30, 1e7]])
    angles, wide = angles.requires_grad_(), angles.double().requires_grad_()
    slope = torch.randn(1001, 3, generator=random)
    found, wanted = to_vectors(angles), to_vectors(wide)
    # half a unit of the last place of numbers up to 1; torch's own float32 sums take three roundings more
    close = 3e-8 if kernel == "native" else 2e-7
    torch.testing.assert_close(found.double(), wanted, rtol=0, atol=close)
    (of_found,) = torch.autograd.grad(found, angles, slope)
    (of_wanted,) = torch.autograd.grad(wanted, wide, slope.double())
    torch.testing.assert_close(of_found.double(), of_wanted, rtol=0, atol=8 * close)


def test_angles_that_are_no_numbers_give_vectors_that_are_none(kernel: str) -> None:  # noqa: ARG001
    angles = torch.tensor([[torch.nan, 0.5], [0.3, torch.inf], [0.3, 0.5]])
    assert to_vectors(angles).isfinite().all(dim=-1).tolist() == [False, False, True]


def test_axes() -> None:
    """Azimuth from the viewer (+z) to the right (+x), polar angle from up (+y)."""
    vectors = torch.tensor([[0.0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]])
    wanted = torch.tensor([[0.0, pi / 2], [pi / 2, pi / 2], [-pi / 2, pi / 2], [0, 0], [0, pi], [pi, pi / 2]])
    torch.testing.assert_close(to_angles(vectors), wanted)


def test_length_does_not_matter_and_zero_is_zero() -> None:
    vectors = torch.tensor([[1e-6, 2e-6, 3e-6], [1.0, 2, 3], [1e6, 2e6, 3e6]], dtype=torch.float64)
    angles = to_angles(vectors)
    torch.testing.assert_close(angles, angles[1].expand(3, 2), rtol=1e-12, atol=0)
    assert to_angles(torch.zeros(3)).tolist() == [0, 0]


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_the_pole_is_safe(up: float) -> None:
    angles = to_angles(torch.tensor([0.0, up, 0.0], dtype=torch.float64)).requires_grad_()
    (gradient,) = torch.autograd.grad(to_vectors(angles).sum(), angles)
    assert float(angles.detach()[0]) == 0
    assert gradient.isfinite().all()
    assert abs(float(gradient[0])) < 1e-15  # the azimuth turns nothing there
    assert float(to_vectors(angles.detach())[1]) == up


def test_seen_normals_are_away_from_the_jump() -> None:
    vectors = torch.randn(1000, 3, generator=torch.Generator().manual_seed(0))
    vectors[:, 2] = vectors[:, 2].abs() + 1e-6
    assert to_angles(vectors)[:, 0].abs().max() <= pi / 2
