"""Sentences about the torch renderer's groups."""

import pytest
import torch

from services.rendering.torch_renderer.words import worded
from tests.unit.rendering.shading import sphere_scene
from tests.unit.rendering.torch_renderer.spheres import sphere


def test_sentences_of_map_and_material() -> None:
    renderer = sphere()
    texels = torch.zeros_like(renderer.initial()["illumination"])
    texels[1, 2], texels[3, 3] = -2.0, 1.0  # of a mean of 10, in 4×8 texels
    material = torch.zeros_like(renderer.initial()["material"])
    material[0, 1, 2, 0, 3] = 30 * torch.tensor(1.1).log()
    found = worded(sphere_scene(), renderer, {"illumination": texels, "material": material})
    size = 10 * (5 / texels.numel()) ** 0.5
    assert [(one.subject, one.sentence) for one in found[:2]] == [
        (
            "environment map",
            f"its texels changed by {size:.2g} % of its mean intensity in the root mean square, −20 % at most",
        ),
        ("material of sphere", "its lobes' κ changed by +10 % at most, their γ by 0 %"),
    ]
    assert [one.subject for one in found if one.curves] == ["material of sphere"]
    [_, _, ratio] = found[0].images
    before = renderer.initial()["illumination"]
    largest = max(before[1, 2] / (before[1, 2] - 2), (before[3, 3] + 1) / before[3, 3])
    assert ratio.words.endswith(f"full colour is a factor of {largest:.3g}")
    assert found[0].values[1].after == pytest.approx(-20)


def test_normals_tilt_by_degrees() -> None:
    renderer = sphere()
    initial = renderer.initial()["normals"]
    change = torch.zeros_like(initial)
    change[..., 1] = torch.where((initial != 0).any(dim=-1), torch.tensor(0.02), torch.tensor(0.0))
    [found] = worded(sphere_scene(), renderer, {"normals": change})
    assert (found.subject, found.sentence) == (
        "surface normals",
        "tilted by 1.1° in the root mean square, 1.1° at most",  # 0.02 radians of the polar angle
    )
    assert [one.words for one in found.images] == ["tilt of the normals, from 0 (violet) to 1.1° (yellow)"]


def test_the_images_of_the_map_stand_with_its_first_change() -> None:
    renderer = sphere()
    initial = renderer.initial()
    groups = ("illumination", "illumination_rgb")
    found = worded(sphere_scene(), renderer, {group: torch.full_like(initial[group], 0.5) for group in groups})
    assert [(one.subject, len(one.images)) for one in found] == [
        ("environment map", 3),
        ("environment map, red", 0),
        ("environment map, green", 0),
        ("environment map, blue", 0),
    ]
