"""The light of a map: its parts, and the directions and solid angles of its texels."""

from math import pi

import numpy as np
import pytest
import torch

from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN, WHITE
from scene_attack.rendering.torch.light import directions, illumination, solid_angles
from tests.unit.rendering.shading import reference_exposure, sky


def test_against_the_definition() -> None:
    environment = sky()
    light = illumination(torch.from_numpy(environment))
    chroma, intensity, exposure = reference_exposure(environment)
    np.testing.assert_allclose(light.chroma.numpy(), chroma, rtol=1e-12)
    np.testing.assert_allclose(light.intensity.numpy(), intensity, rtol=1e-12)
    assert light.exposure == pytest.approx(exposure, rel=1e-12)


def test_mean_and_black_texel() -> None:
    light = illumination(torch.from_numpy(sky()))
    mean = float(light.intensity.flatten() @ solid_angles(4, 8)) / (4 * pi)
    assert mean == pytest.approx(ILLUMINATION_MEAN, rel=1e-12)
    assert light.intensity[0, 0] == 0
    assert light.chroma[0, 0].tolist() == [1, 1, 1]


def test_parts_make_up_the_map() -> None:
    environment = torch.from_numpy(sky()).double()
    light = illumination(environment)
    again = light.chroma * light.intensity[..., None]
    torch.testing.assert_close(again / again.sum(), environment / environment.sum(), rtol=1e-12, atol=0)


@pytest.mark.parametrize("scale", [1e-30, 1e-3, 1e5, 1e30])
def test_the_scale_of_a_map_means_nothing(scale: float) -> None:
    environment = torch.from_numpy(sky())
    plain, scaled = illumination(environment), illumination(environment * scale)
    torch.testing.assert_close(scaled.intensity, plain.intensity, rtol=1e-6, atol=0)
    assert scaled.exposure == pytest.approx(plain.exposure, rel=1e-6)


def test_a_white_map_exposes_white_surfaces_at_white() -> None:
    light = illumination(torch.full((32, 64, 3), 7.0))
    assert light.exposure * ILLUMINATION_MEAN == pytest.approx(WHITE, rel=5e-3)  # midpoint rule, 32 rows


def test_black_map() -> None:
    light = illumination(torch.zeros(4, 8, 3))
    assert (light.intensity == 0).all()
    assert (light.chroma == 1).all()
    assert 0 < light.exposure < 1


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
