from math import pi

import pytest
import torch

from services.rendering.normals import to_angles, to_vectors


def test_vectors_come_back() -> None:
    vectors = torch.nn.functional.normalize(
        torch.randn(1000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    # float64 rounding, times a few operations
    torch.testing.assert_close(to_vectors(to_angles(vectors)), vectors, rtol=0, atol=1e-14)


def test_float32_angles_lose_no_more_than_float32() -> None:
    vectors = torch.nn.functional.normalize(torch.randn(1000, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    torch.testing.assert_close(to_vectors(to_angles(vectors)), vectors, rtol=0, atol=5e-7)


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
