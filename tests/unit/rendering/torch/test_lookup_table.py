"""The table over normals: splines in closed form, the torch twin, gradients, and that it has no border."""

from math import pi

import pytest
import torch
from torch import Tensor

from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.torch.table import (
    N_SORT_KEYS,
    look_up,
    node_vectors,
    normal_sort_keys,
    tiles,
    to_vectors,
    touched,
)

pytestmark = pytest.mark.usefixtures("kernel")


def anywhere(count: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> Tensor:
    """Angles many turns away, past the poles, and on them."""
    random = torch.Generator().manual_seed(seed)
    angles = 4 * torch.randn(count, 2, generator=random, dtype=torch.float64)
    angles[:4, 1] = torch.tensor([0.0, pi, -pi, 2 * pi], dtype=torch.float64)
    return angles.to(dtype)


def smooth(vectors: Tensor) -> Tensor:
    """Some smooth function [N, 3] on the sphere."""
    x, y, z = vectors.unbind(-1)
    return torch.stack((x + 2 * y * z, (1.5 * z).exp() * x, (2 * y).sin() + x * z), dim=-1)


def test_values_at_nodes_are_the_tables() -> None:
    table = torch.randn(2 * 12 * 12, 3, dtype=torch.float64)
    polar = (torch.arange(12, dtype=torch.float64) + 0.5) * pi / 12
    azimuth = (torch.arange(24, dtype=torch.float64) + 0.5) * pi / 12 - pi
    angles = torch.stack((azimuth.repeat(12), polar.repeat_interleave(24)), dim=-1)
    torch.testing.assert_close(look_up(table, angles), table, rtol=0, atol=1e-12)
    torch.testing.assert_close(node_vectors(12), to_vectors(angles))


def test_error_falls_with_the_cube_of_the_mesh_everywhere() -> None:
    """Catmull-Rom is of third order; at the poles and past them too, or the function would be torn there."""
    angles = anywhere(4000)
    truth = smooth(to_vectors(angles))
    errors = [float((look_up(smooth(node_vectors(rows)), angles) - truth).abs().max()) for rows in (16, 32, 64)]
    assert errors[0] > 6 * errors[1] > 36 * errors[2]
    assert errors[2] < 1e-3


def test_error_of_slopes_falls_with_the_square_of_the_mesh() -> None:
    """The derivative of a curve that is off by h³ is off by h²."""
    leaf = anywhere(4000).requires_grad_()
    (truth,) = torch.autograd.grad(smooth(to_vectors(leaf)).sum(), leaf)
    errors = []
    for rows in (32, 64, 128):
        (found,) = torch.autograd.grad(look_up(smooth(node_vectors(rows)), leaf).sum(), leaf)
        errors.append(float((found - truth).square().mean().sqrt()))
    assert errors[0] > 3.5 * errors[1] > 12 * errors[2]
    assert errors[0] < 5 * errors[1]


@pytest.mark.parametrize("wanted", ["table", "angles", "both"])
def test_gradcheck(wanted: str) -> None:
    random = torch.Generator().manual_seed(1)
    table = torch.randn(2 * 8 * 8, 3, generator=random, dtype=torch.float64).requires_grad_(wanted != "angles")
    angles = anywhere(7).requires_grad_(wanted != "table")
    assert torch.autograd.gradcheck(look_up, (table, angles))


def test_slopes_are_continuous() -> None:
    """From mesh to mesh, or a sign of the gradient would depend on which side of a node a normal is."""
    table = torch.randn(2 * 8 * 8, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    at_nodes = torch.stack(torch.meshgrid(*(torch.arange(8) * pi / 8 + pi / 16,) * 2, indexing="ij"), -1).reshape(-1, 2)
    slopes = []
    for side in (-1e-9, 1e-9):
        leaf = (at_nodes.double() + side).requires_grad_()
        slopes.append(torch.autograd.grad(look_up(table, leaf).sum(), leaf)[0])
    torch.testing.assert_close(slopes[0], slopes[1], rtol=0, atol=1e-6)


def test_native_and_torch_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    angles, table = anywhere(500), smooth(node_vectors(24))
    found, marked = look_up(table, angles), touched(angles, 24)
    monkeypatch.setattr(compiled, "library", lambda: None)
    torch.testing.assert_close(look_up(table, angles), found, rtol=1e-12, atol=1e-12)
    assert torch.equal(touched(angles, 24), marked)


def test_a_lookup_reads_nothing_but_touched_tiles() -> None:
    angles = anywhere(40, dtype=torch.float32)
    table = smooth(node_vectors(64)).float()
    poisoned = torch.full_like(table, torch.nan)
    kept = tiles(64)[touched(angles, 64)].flatten()
    assert len(kept) < len(table) / 2
    poisoned[kept] = table[kept]
    assert torch.equal(look_up(poisoned, angles), look_up(table, angles))


def test_tiles_are_squares_of_all_nodes() -> None:
    assert torch.equal(tiles(16).flatten().sort().values, torch.arange(512))
    corners = node_vectors(16)[tiles(16)]
    assert (corners[:, 0] @ corners[:, 15].T).diagonal().min() > 0.7  # 3 meshes apart both ways


def test_near_places_are_near_normals() -> None:
    angles = anywhere(20_000) % torch.tensor([2 * pi, pi], dtype=torch.float64) - torch.tensor([pi, 0.0])
    numbers = normal_sort_keys(angles)
    assert numbers.min() >= 0
    assert numbers.max() < N_SORT_KEYS
    ordered = to_vectors(angles[numbers.argsort()])
    assert (ordered[1:] * ordered[:-1]).sum(-1).mean() > 0.99
