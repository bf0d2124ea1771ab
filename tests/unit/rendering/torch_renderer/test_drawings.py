"""Images and curves of what an attack changed, against closed forms."""

from math import cos, exp, pi, radians

import pytest
import torch

from services.rendering.torch_renderer.words import (
    VIEWERS,
    drawn,
    images_of,
    intensities,
    map_image,
    ratio_image,
    reflectances,
    stops,
    tilt_image,
    tilts,
)
from tests.unit.rendering.torch_renderer.spheres import sphere


def test_tilts_are_angles_between_normals() -> None:
    """Near the pole a change of the azimuth turns the normal by sin θ times as much; no surface has no tilt."""
    initial = torch.tensor([[[0.3, radians(90)], [0.3, radians(30)], [0.0, 0.0]]])
    change = torch.zeros(1, 3, 2)
    change[..., 0] = 0.01
    found = tilts(initial, change)[0]
    assert found[:2].tolist() == pytest.approx([0.01 * 180 / pi, 0.005 * 180 / pi], rel=1e-4)
    assert found[2].isnan()
    shown = tilt_image(found[None])[0].tolist()
    assert shown == [[253, 231, 37], [33, 145, 140], [128, 128, 128]]  # the largest, half of it, no surface


def test_no_tilt_is_the_scale_s_beginning() -> None:
    assert tilt_image(torch.zeros(1, 1))[0, 0].tolist() == [68, 1, 84]


def test_maps_in_means_with_colours_added() -> None:
    values = {"illumination": torch.full((2, 4), 10.0), "illumination_rgb": torch.zeros(2, 4, 3)}
    values["illumination_rgb"][1, 2, 0] = 30.0
    found = intensities(values)
    assert found[0, 0].tolist() == [1, 1, 1]
    assert found[1, 2].tolist() == [4, 1, 1]
    image = map_image(found)
    assert image.shape == (256, 512, 3)
    assert image[255, 383].tolist() == [255, *[round(255 * 0.25 ** (1 / 2.2))] * 2]


def test_ratios_are_logarithmic_and_signed() -> None:
    before = torch.ones(2, 2, 3)
    after = before.clone()
    after[0, 0], after[1, 1] = 4.0, 0.5
    found = stops(before, after)
    assert found.tolist() == [[2, 0], [0, -1]]
    image = ratio_image(found)
    assert image[0, 0].tolist() == [255, 0, 0]
    assert image[0, 511].tolist() == [255, 255, 255]
    assert image[511, 511].tolist() == [128, 128, 255]
    assert (ratio_image(torch.zeros(2, 2)) == 255).all()


def test_what_is_nearly_dark_before_and_after_has_not_changed() -> None:
    assert stops(torch.full((1, 1, 3), 1e-4), torch.full((1, 1, 3), 0.01)).tolist() == [[0]]


def test_reflectance_of_one_lobe_by_its_formula() -> None:
    """log κ = 1, γ = 4 in one lobe of one channel; the others are dark."""
    material = torch.full((3, 3, 2, 6), -600.0)  # e⁻²⁰
    material[1, 0, 0], material[1, 0, 1] = 30.0, 30 * torch.tensor(4.0).log()
    found = reflectances(material)
    expected = [exp(exp(1) * cos(radians(abs(angle - 45) / 2)) ** 4) - 1 for angle in VIEWERS]
    assert found[1].tolist() == pytest.approx(expected, rel=1e-5)
    assert VIEWERS[int(found[1].argmax())] == 45
    assert float(found[0].max()) < 1e-6


def test_a_perturbation_has_the_files_that_its_changes_name() -> None:
    renderer = sphere()
    initial = renderer.initial()
    perturbation = {group: torch.full_like(initial[group], 0.01) for group in ("normals", "illumination", "material")}
    found = drawn(renderer, perturbation)
    subjects = ("surface normals", "environment map")
    assert set(found) == {one.file for subject in subjects for one in images_of(subject, initial, perturbation)}
    assert all(image.dtype == torch.uint8 and image.shape[2] == 3 for image in found.values())
    assert found["normals-tilt.png"].shape[:2] == initial["normals"].shape[:2]
    assert drawn(renderer, {}) == {}
