"""Sizes, sentences and images of changes of the torch renderer's groups, against closed forms."""

from math import cos, exp, pi, radians

import pytest
import torch
from torch import Tensor

from scene_attack.rendering.physical_change import PhysicalChange, worded
from scene_attack.rendering.torch.dsbrdf import MATERIAL_UNIT
from scene_attack.rendering.torch.words import (
    VIEWERS,
    drawn,
    intensities,
    map_image,
    normals,
    ratio_image,
    reflectances,
    stops,
    tilt_image,
    tilts,
)
from tests.unit.rendering.shading import sphere_scene
from tests.unit.rendering.torch.spheres import sphere


def sizes(**perturbation: Tensor) -> list[PhysicalChange]:
    return [size for thing in worded(sphere_scene(), sphere(), perturbation) for size in thing.sizes]


def test_angles_between_normals_are_not_those_of_their_parameters() -> None:
    """Near the pole a change of the azimuth turns the normal by sin θ times as much; no surface has no tilt, whatever
    an attack did to its angles."""
    initial = torch.tensor([[[0.3, radians(90)], [0.3, radians(30)], [0.0, 0.0]]])
    change = torch.tensor([[[0.01, 0.0], [0.01, 0.0], [0.0, 1.4]]])
    whole = 0.01 * 180 / pi
    rms, largest = normals(initial, change).sizes
    assert (rms.unit, largest.unit) == ("degrees", "degrees")
    assert largest.value == pytest.approx(whole, rel=1e-4)
    assert rms.value == pytest.approx(whole * ((1 + 0.25) / 2) ** 0.5, rel=1e-4)
    found = tilts(initial, change)[0]
    assert found[:2].tolist() == pytest.approx([whole, whole / 2], rel=1e-4)
    assert found[2].isnan()
    shown = tilt_image(found[None])[0].tolist()
    assert shown == [[253, 231, 37], [33, 145, 140], [128, 128, 128]]  # the largest, half of it, no surface


def test_coloured_light_is_worded_by_channel() -> None:
    """Each channel has its own percent: a change of blue alone shows in no other channel."""
    change = torch.zeros_like(sphere().initial()["illumination_rgb"])
    change[1, 2, 2], change[3, 3, 0] = -2.0, 0.5
    found = sizes(illumination_rgb=change)
    largest = {size.subject: size.value for size in found if size.measure == "largest texel"}
    assert largest == pytest.approx({"map, red": 5.0, "map, green": 0.0, "map, blue": -20.0})
    assert {size.group for size in found} == {"illumination_rgb"}
    rms = {size.subject: size.value for size in found if size.measure != "largest texel"}
    assert rms["map, blue"] == pytest.approx(20 / 32**0.5)


def test_the_largest_change_of_a_lobe_is_the_largest_in_percent() -> None:
    """A third is further from 1 than double as a logarithm, and nearer in percent."""
    change = torch.zeros(1, 3, 3, 2, 6, dtype=torch.float64)
    change[0, 0, 0, 0, :2] = torch.tensor([1 / 3, 2.0], dtype=torch.float64).log() * MATERIAL_UNIT
    change[0, 0, 0, 1, 5] = -torch.tensor(2.0).log() * MATERIAL_UNIT
    kappa, gamma = sizes(material=change)
    assert (kappa.subject, gamma.subject) == ("object 0 κ", "object 0 γ")
    assert kappa.value == pytest.approx(100)
    assert gamma.value == pytest.approx(-50)


def test_sentences_of_map_and_material() -> None:
    renderer = sphere()
    before = renderer.initial()["illumination"]
    texels = torch.zeros_like(before)
    texels[1, 2], texels[3, 3] = -2.0, 1.0  # of a mean of 10, in 4×8 texels
    material = torch.zeros_like(renderer.initial()["material"])
    material[0, 1, 2, 0, 3] = 30 * torch.tensor(1.1).log()
    found = worded(sphere_scene(), renderer, {"illumination": texels, "material": material})
    size = 10 * (5 / texels.numel()) ** 0.5
    assert [(thing.change.subject, thing.change.sentence) for thing in found[:2]] == [
        (
            "environment map",
            f"its texels changed by {size:.2g} % of its mean intensity in the root mean square, −20 % at most",
        ),
        ("material of sphere", "its lobes' κ changed by +10 % at most, their γ by 0 %"),
    ]
    assert [thing.change.subject for thing in found if thing.change.curves] == ["material of sphere"]
    [_, _, ratio] = found[0].change.images
    largest = max(before[1, 2] / (before[1, 2] - 2), (before[3, 3] + 1) / before[3, 3])
    assert ratio.words.endswith(f"full colour is a factor of {largest:.3g}")
    assert [value.after for value in found[0].change.values] == pytest.approx([size, -20])


def test_normals_tilt_by_degrees() -> None:
    initial = sphere().initial()["normals"]
    change = torch.zeros_like(initial)
    change[..., 1] = torch.where((initial != 0).any(dim=-1), torch.tensor(0.02), torch.tensor(0.0))
    [found] = worded(sphere_scene(), sphere(), {"normals": change})
    assert (found.change.subject, found.change.sentence) == (
        "surface normals",
        "tilted by 1.1° in the root mean square, 1.1° at most",  # 0.02 radians of the polar angle
    )
    assert [image.words for image in found.change.images] == ["tilt of the normals, from 0 (violet) to 1.1° (yellow)"]


def test_the_images_of_the_map_stand_with_its_first_change() -> None:
    initial = sphere().initial()
    groups = ("illumination", "illumination_rgb")
    found = worded(sphere_scene(), sphere(), {group: torch.full_like(initial[group], 0.5) for group in groups})
    assert [(thing.change.subject, len(thing.change.images)) for thing in found] == [
        ("environment map", 3),
        ("environment map, red", 0),
        ("environment map, green", 0),
        ("environment map, blue", 0),
    ]


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
    named = {image.file for thing in worded(sphere_scene(), renderer, perturbation) for image in thing.change.images}
    assert set(found) == named
    assert all(image.dtype == torch.uint8 and image.shape[2] == 3 for image in found.values())
    assert found["normals-tilt.png"].shape[:2] == initial["normals"].shape[:2]
    assert drawn(renderer, {}) == {}
