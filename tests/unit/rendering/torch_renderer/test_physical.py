"""Degrees and percent of the torch renderer's groups against closed forms."""

from math import radians

import pytest
import torch

from services.rendering.torch_renderer.dsbrdf import MATERIAL_UNIT
from services.rendering.torch_renderer.words import changes, map_changes, material_changes, normal_changes
from tests.unit.rendering.shading import sphere_scene
from tests.unit.rendering.torch_renderer.spheres import sphere


def test_angles_between_normals_are_not_those_of_their_parameters() -> None:
    """Near the pole a change of the azimuth hardly turns the normal: by sin θ times as much."""
    initial = torch.tensor([[[0.3, radians(90)], [0.3, radians(30)], [0.0, 0.0]]])
    change = torch.zeros(1, 3, 2)
    change[..., 0] = 1e-3
    rms, largest = normal_changes(initial, change, torch.tensor([[True, True, False]]))
    assert (rms.unit, largest.unit) == ("degrees", "degrees")
    whole = 1e-3 * 180 / torch.pi
    assert largest.value == pytest.approx(whole, rel=1e-3)
    assert rms.value == pytest.approx(whole * ((1 + 0.25) / 2) ** 0.5, rel=1e-3)


def test_texels_are_relative_to_the_mean() -> None:
    change = torch.zeros(4, 8)
    change[1, 2], change[3, 3] = -2.0, 1.0
    rms, largest = map_changes("illumination", "map", change)
    assert largest.value == pytest.approx(-20)  # the mean is 10
    assert rms.value == pytest.approx(10 * (5 / 32) ** 0.5)


def test_coloured_light_is_worded_by_channel() -> None:
    """Each channel has its own percent: a change of blue alone shows in no other channel."""
    renderer = sphere()
    change = torch.zeros_like(renderer.initial()["illumination_rgb"])
    change[1, 2, 2], change[3, 3, 0] = -2.0, 0.5
    found = changes(sphere_scene(), renderer, {"illumination_rgb": change})
    largest = {one.subject: one.value for one in found if one.measure == "largest texel"}
    assert largest == pytest.approx({"map, red": 5.0, "map, green": 0.0, "map, blue": -20.0})
    assert {one.group for one in found} == {"illumination_rgb"}
    rms = {one.subject: one.value for one in found if one.measure != "largest texel"}
    assert rms["map, blue"] == pytest.approx(20 / 32**0.5)


def test_coefficients_are_logarithms() -> None:
    change = torch.zeros(1, 3, 3, 2, 6)
    change[0, 1, 2, 0, 3] = 30 * torch.tensor(1.1).log()
    change[0, 0, 0, 1, 5] = -30 * torch.tensor(2.0).log()
    kappa, gamma = material_changes(change)
    assert (kappa.subject, gamma.subject) == ("object 0 κ", "object 0 γ")
    assert kappa.value == pytest.approx(10, rel=1e-5)
    assert gamma.value == pytest.approx(-50, rel=1e-5)


def test_pixels_without_a_surface_have_no_normal_to_turn() -> None:
    """Their angles are 0, and no part of the mean, whatever an attack did to them."""

    class TwoOfFour:
        def initial(self) -> dict[str, torch.Tensor]:
            return {"normals": torch.tensor([[[0.2, radians(90)], [-0.1, radians(90)]], [[0.0, 0.0], [0.0, 0.0]]])}

    change = torch.zeros(2, 2, 2)
    change[0, 0, 0], change[1, 0, 1] = radians(3), radians(80)
    rms, largest = changes(None, TwoOfFour(), {"normals": change})  # type: ignore[arg-type]
    assert largest.value == pytest.approx(3, rel=1e-4)
    assert rms.value == pytest.approx(3 / 2**0.5, rel=1e-4)


def test_the_largest_change_of_a_lobe_is_the_largest_in_percent() -> None:
    """A third is further from 1 than double as a logarithm, and nearer in percent."""
    change = torch.zeros(1, 3, 3, 2, 6, dtype=torch.float64)
    change[0, 0, 0, 0, :2] = torch.tensor([1 / 3, 2.0], dtype=torch.float64).log() * MATERIAL_UNIT
    kappa, _ = material_changes(change)
    assert kappa.value == pytest.approx(100)
