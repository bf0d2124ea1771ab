"""A variation against a scene that is described anew from that view and in that light."""

from math import radians
from typing import Any

import numpy as np
import pytest
from torch import Tensor

from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.factory import build
from scene_attack.rendering.protocol import Renderer
from scene_attack.rendering.variation import Variation, varied
from scene_attack.scenes.description import Scene
from scene_attack.scenes.image_file import to_linear
from scene_attack.scenes.resolve import resolve
from tests.unit.jobs.small import LIBRARY

CAMERA: dict[str, Any] = {"size": [48, 48], "azimuth": 0.5, "elevation": 0.4, "distance": 2.0}
LIGHTS: dict[str, Any] = {
    "ambient": 0.2,
    "points": [{"energy": 20, "position": [1.0, 2.0, 1.5]}],
    "directional": [{"energy": 2, "direction": [0.3, -1.0, 0.2]}],
}


def renderer(name: str, camera: dict[str, Any] = CAMERA, lights: dict[str, Any] = LIGHTS) -> Renderer:
    scene = {"objects": [{"mesh": "primitive/cube", "color": [0.8, 0.5, 0.3]}], "camera": camera, "lights": lights}
    groups = RENDERERS[name].group_names
    return build(resolve(Scene.model_validate(scene), LIBRARY), name, None, groups, "exact")


def render(of: Renderer, variation: Variation) -> Tensor:
    start = {group: value[None] for group, value in of.initial().items()}
    return of.render(varied(of, start, variation))[0]


@pytest.mark.parametrize(
    ("variation", "camera"),
    [
        (Variation(azimuth=radians(20)), CAMERA | {"azimuth": 0.5 + radians(20)}),
        (Variation(elevation=radians(-10)), CAMERA | {"elevation": 0.4 - radians(10)}),
        (Variation(distance=1.2), CAMERA | {"distance": 2.4}),
    ],
)
def test_another_view_is_that_of_the_scene_described_so(variation: Variation, camera: dict[str, Any]) -> None:
    ours, theirs = render(renderer("pyrender"), variation), render(renderer("pyrender", camera), Variation())
    assert float((ours - theirs).abs().max()) < 1e-4
    assert float((ours - render(renderer("pyrender"), Variation())).abs().max()) > 0.05


def test_a_roll_by_half_a_turn_turns_the_image() -> None:
    """By two reflections, but for the pixels that the silhouette crosses: the sampling pattern does not turn."""
    of = renderer("pyrender")
    upright, turned = render(of, Variation()), render(of, Variation(roll=radians(180)))
    apart = (turned - upright.flip(0, 1)).abs().amax(dim=-1)
    assert float((apart > 0.02).double().mean()) < 0.08
    assert float(((turned - upright).abs().amax(dim=-1) > 0.02).double().mean()) > 0.2


def test_stronger_light_is_that_of_the_scene_described_so() -> None:
    stronger = {
        "ambient": 0.3,
        "points": [LIGHTS["points"][0] | {"energy": 30}],
        "directional": [LIGHTS["directional"][0] | {"energy": 3}],
    }
    ours = render(renderer("pyrender"), Variation(intensity=1.5))
    assert float((ours - render(renderer("pyrender", lights=stronger), Variation())).abs().max()) < 1e-4


@pytest.mark.parametrize(("tint", "lamp"), [(0.0, 0.0), (4.0, 0.0), (0.0, 0.3)])
def test_the_torch_renderers_light_is_scaled_before_the_display_curve(tint: float, lamp: float) -> None:
    """Where an object covers a pixel and no channel is saturated; coloured light that is attacked is scaled too."""
    of = renderer("torch")
    start = {group: value[None].clone() for group, value in of.initial().items()}
    start["illumination_rgb"][..., 2] += tint
    start["lamp"] += lamp
    plain, dimmed = (of.render(varied(of, start, Variation(intensity=factor)))[0] for factor in (1.0, 0.5))
    changed = ((plain - dimmed).abs().amin(dim=-1) > 0.05) & (plain.amax(dim=-1) < 0.98)
    assert int(changed.sum()) > 200
    ratio = to_linear(dimmed[changed].double().numpy()) / to_linear(plain[changed].double().numpy())
    assert np.median(ratio, axis=0) == pytest.approx(np.full(3, 0.5), abs=1e-3)


def test_a_view_is_kept_within_the_cameras_limits() -> None:
    of = renderer("pyrender")
    start = {group: value[None] for group, value in of.initial().items()}
    found = varied(of, start, Variation(elevation=radians(170)))
    assert float(found["camera"][0, 1]) == float(of.bounds()["camera"][1][1])
