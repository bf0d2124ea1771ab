from math import pi

import pytest
import torch

from services.rendering.torch_renderer.light import directions, solid_angles

SIZES = [(1, 1), (1, 4), (3, 5), (16, 32)]


@pytest.mark.parametrize(("rows", "cols"), SIZES)
def test_solid_angles_fill_the_sphere(rows: int, cols: int) -> None:
    assert float(solid_angles(rows, cols).sum()) == pytest.approx(4 * pi, rel=1e-14)
    assert solid_angles(rows, cols).shape == (rows * cols,)


@pytest.mark.parametrize(("rows", "cols"), SIZES)
def test_directions_are_unit(rows: int, cols: int) -> None:
    lengths = torch.linalg.vector_norm(directions(rows, cols), dim=-1)
    torch.testing.assert_close(lengths, torch.ones_like(lengths), rtol=1e-15, atol=0)


def test_rows_go_down_and_columns_from_front_to_right() -> None:
    grid = directions(2, 4).reshape(2, 4, 3)
    assert (grid[0, :, 1] > 0).all()
    assert (grid[1, :, 1] < 0).all()
    # column centres at azimuth 45°, 135°, … from +z towards +x
    assert [(x > 0, z > 0) for x, z in grid[0, :, [0, 2]].tolist()] == [
        (True, True),
        (True, False),
        (False, False),
        (False, True),
    ]


def test_the_sum_integrates() -> None:
    """Hemisphere of cosines is π; the midpoint rule's relative error is below (π/rows)²/6."""
    for rows in (8, 16, 32):
        up = directions(rows, 2 * rows)[:, 1].clamp_min(0)
        assert float(up @ solid_angles(rows, 2 * rows)) == pytest.approx(pi, rel=(pi / rows) ** 2 / 6)
