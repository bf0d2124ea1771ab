"""Environment maps: directions, solid angles, rotation, and what a file may hold."""

from math import cos, pi, sin

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.scenes.environment import average, from_image, read_file, uniform


def direction(row, column, rows, cols):
    theta, phi = (row + 0.5) * pi / rows, (column + 0.5) * 2 * pi / cols
    return np.array([sin(theta) * sin(phi), cos(theta), sin(theta) * cos(phi)])


def solid_angles(rows, cols):
    edges = np.cos(np.linspace(0, pi, rows + 1))
    return np.repeat(((edges[:-1] - edges[1:]) * 2 * pi / cols)[:, None], cols, axis=1)


def light(radiance):
    return np.einsum("ijc,ij->c", radiance.astype(np.float64), solid_angles(*radiance.shape[:2]))


def spot(rows, cols, row, column):
    image = np.zeros((rows, cols, 3), np.float32)
    image[row, column] = 1
    return image


@pytest.mark.parametrize(
    ("u", "expected"),
    [(0.5, (1, 0, 0)), (0.75, (0, 0, 1)), (0.25, (0, 0, -1)), (0.0, (-1, 0, 0))],
)
@pytest.mark.parametrize("width", [64, 66])
def test_a_bright_column_of_a_image_lands_in_its_direction(u, expected, width):
    # Reference: what Blender's equirectangular mapping calls direction_to_equirectangular, in +y-up coordinates.
    column = round(u * width) % width
    image = np.zeros((8, width, 3), np.float32)
    image[:, [column - 1, column]] = 1
    turned = from_image(image)
    centre = sum(direction(3, j, 8, width) * [1, 0, 1] * turned[3, j, 0] for j in range(width))
    assert np.dot(centre / np.linalg.norm(centre), expected) > 0.995


def test_a_image_is_not_mirrored():
    # Seen from inside, looking along −z (u = ¼) with +y up, +x is to the right: right in the image is larger u.
    image = spot(8, 64, 3, 64 // 4 + 4)
    row, column = np.argwhere(from_image(image)[..., 0])[0]
    assert direction(row, column, 8, 64)[0] > 0.3


def test_the_top_row_is_up():
    row, column = np.argwhere(from_image(spot(8, 16, 0, 0))[..., 0])[0]
    assert direction(row, column, 8, 16)[1] > 0.9


@pytest.mark.parametrize(("rows", "cols"), [(1, 1), (3, 7), (16, 32), (5, 64), (40, 90)])
@pytest.mark.parametrize("rotation", [0.0, 1.234, -5.0, 2 * pi])
def test_averaging_keeps_the_light_of_the_whole_sphere(rows, cols, rotation):
    radiance = np.random.default_rng(0).gamma(0.3, 5, (24, 50, 3)).astype(np.float32)
    # Sums of float32 texels: 1e-6 relative is a few roundings.
    assert np.allclose(light(average(radiance, rows, cols, rotation)), light(radiance), rtol=2e-6)


def test_averaging_weighs_by_solid_angle_not_by_texel():
    radiance = np.zeros((4, 4, 3), np.float32)
    radiance[0] = 1
    # The polar cap of a hemisphere: 1 − cos 45° of its solid angle, not half.
    assert np.allclose(average(radiance, 2, 1)[0, 0], 1 - cos(pi / 4), rtol=1e-6)


def test_averaging_matches_a_dense_sample():
    radiance = np.random.default_rng(1).random((9, 14, 3)).astype(np.float32)
    rows, cols, rotation, n = 4, 5, 0.7, 200
    height = np.cos(np.arange(rows)[:, None] * pi / rows), np.cos((np.arange(rows)[:, None] + 1) * pi / rows)
    y = height[0] + (height[1] - height[0]) * (np.arange(n) + 0.5) / n
    i = np.clip((np.arccos(y) / pi * 9).astype(int), 0, 8)
    phi = (np.arange(cols)[:, None] + (np.arange(n) + 0.5) / n) * 2 * pi / cols
    j = np.floor(np.mod(phi - rotation, 2 * pi) / (2 * pi) * 14).astype(int) % 14
    dense = radiance[i[:, :, None, None], j[None, None]].mean(axis=(1, 3))
    # 200 samples a side: the edges of the nine or fourteen texels are met to 1/200.
    assert np.abs(average(radiance, rows, cols, rotation) - dense).max() < 0.01


@pytest.mark.parametrize("quarter", [0, 1, 2, 3])
def test_a_positive_rotation_turns_z_towards_x(quarter):
    rows, cols = 4, 16
    radiance = spot(rows, cols, 1, 0)
    row, column = np.argwhere(average(radiance, rows, cols, quarter * pi / 2)[..., 0] > 0.5)[0]
    before, after = direction(1, 0, rows, cols), direction(row, column, rows, cols)
    angle = quarter * pi / 2
    about_y = np.array([[cos(angle), 0, sin(angle)], [0, 1, 0], [-sin(angle), 0, cos(angle)]])
    assert np.allclose(after, about_y @ before, atol=1e-9)


def test_the_same_grid_is_the_same_map():
    radiance = np.random.default_rng(2).random((16, 32, 3)).astype(np.float32)
    assert np.allclose(average(radiance, 16, 32), radiance, rtol=1e-6)


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 20), st.integers(1, 20), st.floats(-7, 7))
def test_an_even_map_stays_even(height, width, rows, cols, rotation):
    assert np.allclose(average(np.full((height, width, 3), 0.5, np.float32), rows, cols, rotation), 0.5, rtol=1e-6)


def write(path, pixels, name="RGB"):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: pixels}).write(str(path))


def test_negative_light_becomes_none(tmp_path):
    pixels = np.ones((4, 8, 3), np.float32)
    pixels[0, 0] = -1
    write(tmp_path / "a.exr", pixels)
    found = read_file(tmp_path / "a.exr", None)
    assert found.radiance.dtype == np.float32
    assert (found.radiance[0] == 0).all(axis=1).sum() == 1
    assert (found.radiance[1:] == 1).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_light_that_is_no_number_is_refused(tmp_path, value):
    # A texel that overflowed is the brightest of all: made dark, the map would be another one.
    pixels = np.ones((4, 8, 3), np.float32)
    pixels[0, 1, 2], pixels[3, 3] = value, value
    write(tmp_path / "a.exr", pixels)
    with pytest.raises(InvalidRequest, match="2 of its texels are not finite") as refused:
        read_file(tmp_path / "a.exr", None)
    assert refused.value.field == "environment"


def test_alpha_and_half_floats_are_read(tmp_path):
    write(tmp_path / "a.exr", np.full((2, 4, 4), 0.25, np.float16), "RGBA")
    assert read_file(tmp_path / "a.exr", None).radiance.tolist() == np.full((2, 4, 3), 0.25).tolist()


@pytest.mark.parametrize("data", [None, b"", b"not an image", b"v/1\x01garbage"])
def test_an_unreadable_file_is_a_missing_asset(tmp_path, data):
    if data is not None:
        (tmp_path / "a.exr").write_bytes(data)
    with pytest.raises(JobFailure, match=r"asset-missing.*a\.exr"):
        read_file(tmp_path / "a.exr", None)


def test_uniform_is_one_everywhere():
    assert average(uniform().radiance, 16, 32, 0.3) == pytest.approx(1.0)
