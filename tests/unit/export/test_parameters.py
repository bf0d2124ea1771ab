"""The table of parameters, in the scene's own units; and environment maps as files, read back."""

import numpy as np
import OpenEXR
import pytest
import torch

from scene_attack.export.parameters import equirectangular, normal_maps, parameter_table, write_exr
from scene_attack.scenes.description import DirectionalLight, Lights, PointLight
from scene_attack.scenes.environment import average, from_image, read_file
from tests.unit.rendering.shapes import mesh, placed, quad, scene

LIGHTS = Lights(points=(PointLight(energy=12),), directional=(DirectionalLight(energy=6, direction=(0, -2, 0)),))
RESOLVED = placed(scene(lights=LIGHTS), mesh(quad()))


def test_every_coordinate_has_name_unit_and_values_in_the_scenes_units() -> None:
    change = {
        "illumination": torch.tensor([0.1, 0.5, 0.25, 0.0, 0.0, 1.0, 0.0, 0.5, 0.0]),
        "rotation": torch.tensor([[0.0, 0.2, 0.0]]),
    }
    rows = {row.name: row for row in parameter_table(RESOLVED, "pyrender", change, {}).parameters}
    assert list(rows)[-1] == "object 0 rotation z"
    energy = rows["point 0 energy"]
    assert (energy.before, energy.after, energy.unit) == (12, pytest.approx(12 + 0.5 * 30), "radiant intensity")
    sun = rows["directional 0 energy"]
    assert (sun.before, sun.after, sun.unit) == (6, pytest.approx(6 + 3), "irradiance")
    assert rows["point 0 x"].unit == "scene units"
    assert rows["directional 0 direction y"].unit == "1 (of a unit vector)"
    assert rows["directional 0 direction y"].after == pytest.approx(-0.5)
    assert rows["object 0 rotation y"].change == pytest.approx(0.2)


def test_groups_of_many_values_name_their_files() -> None:
    change = {"normals": torch.zeros(3, 4, 2), "material": torch.zeros(1, 3, 3, 2, 6)}
    table = parameter_table(RESOLVED, "torch", change, {"normals": ("normals_before.npy", "normals_after.npy")})
    assert table.parameters == []
    normals, material = table.large
    assert (normals.shape, normals.axes) == ([3, 4, 2], ["H", "W", "2"])
    assert normals.files == ["normals_before.npy", "normals_after.npy"]
    assert material.tensor == "perturbation.safetensors: material"


@pytest.mark.parametrize(
    ("group", "change"),
    [
        ("lamp", torch.tensor([0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])),
        ("dials", torch.tensor([[0.0, 0.5, 0.0, 0.0, 0.0]])),
        ("translation", torch.tensor([[0.0, 0.5, 0.0]])),
        ("camera", torch.tensor([0.0, 0.5, 0.0, 0.0])),
    ],
)
def test_few_values_of_the_torch_renderer_are_in_the_table(group: str, change: torch.Tensor) -> None:
    table = parameter_table(RESOLVED, "torch", {group: change}, {})
    assert table.large == []
    assert [row.change for row in table.parameters] == pytest.approx(change.flatten().tolist())


@pytest.mark.parametrize(
    ("group", "change"),
    [("rotation", torch.tensor([[0.0, 0.3, 0.0]])), ("camera", torch.tensor([0.0, 0.3, 0.0, 0.0]))],
)
def test_normals_after_a_move_are_those_of_the_moved_scene(group: str, change: torch.Tensor) -> None:
    """They are said to be what the pixels of the attacked image are shaded by."""
    maps = normal_maps(RESOLVED, {group: change})
    seen = (maps.before != 0).any(-1) & (maps.after != 0).any(-1)
    turned = np.degrees(np.arccos((maps.before * maps.after).sum(-1)[seen].clip(-1, 1)))
    assert np.median(turned) == pytest.approx(np.degrees(0.3), rel=0.1)


@pytest.mark.parametrize(("rows", "cols"), [(1, 4), (8, 16), (5, 6), (3, 7)])
def test_a_map_comes_back_with_every_bit(tmp_path, rows: int, cols: int) -> None:
    radiance = np.random.default_rng(0).gamma(0.5, 9, (rows, cols, 3)).astype(np.float32)
    write_exr(radiance, tmp_path / "map.exr", "a map")
    read = read_file(tmp_path / "map.exr", None).radiance
    wide = read.shape[1] // cols
    assert wide == (1 if cols % 4 == 0 else 4)
    assert np.array_equal(read[:, ::wide], radiance)
    assert np.allclose(average(read, rows, cols), radiance, rtol=1e-6)


def test_the_middle_column_of_the_image_is_plus_x_and_plus_z_is_to_its_right() -> None:
    """Column j of a map looks along the azimuth (j + 1/2) 2 pi / cols, from +z towards +x."""
    radiance = np.zeros((1, 8, 3), np.float32)
    radiance[0, 2], radiance[0, 0] = 1, 2  # just after +x; just after +z
    image = equirectangular(radiance)[0, :, 0]
    assert list(image.nonzero()[0]) == [3, 5]
    assert (image[3], image[5]) == (1, 2)
    assert np.array_equal(from_image(equirectangular(radiance)), radiance)


def test_the_file_says_what_its_numbers_are(tmp_path) -> None:
    write_exr(np.ones((2, 4, 3), np.float32), tmp_path / "map.exr", "radiance of a test")
    with OpenEXR.File(str(tmp_path / "map.exr")) as file:
        assert file.header()["comments"] == "radiance of a test"
        assert file.channels()["RGB"].pixels.dtype == np.float32
