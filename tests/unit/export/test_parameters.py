"""The table of parameters, in the scene's own units."""

import pytest
import torch

from services.export.parameters import parameter_table
from services.scenes.description import DirectionalLight, Lights, PointLight
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
