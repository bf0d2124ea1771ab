"""Shadows on a floor: in both renderers they are those on the same square as an object, and there is one to see."""

from dataclasses import replace
from math import pi, sqrt
from typing import Any

import pytest
import torch
from torch import Tensor

from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack_service.settings import Settings

SIDE = 2.5
BALL = {"mesh": "primitive/sphere", "material": "matte", "scale": 0.4, "color": (0.8, 0.3, 0.1)}
SURFACE = {"color": (0.4, 0.5, 0.6), "material": "matte"}
FLOOR = {"size": SIDE, "height": -0.4} | SURFACE
SQUARE = {
    "mesh": "primitive/plane",
    "rotation": (-pi / 2, 0.0, 0.0),
    "scale": SIDE / (sqrt(2) * FIT_RADIUS),
    "translation": (0.0, -0.4, 0.0),
} | SURFACE


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(Settings().cache_dir, tmp_path_factory.mktemp("data"))


def scene(library: Library, *objects: dict[str, Any], **more: Any) -> ResolvedScene:
    lights = {
        "ambient": 0.3,
        "points": [{"energy": 20, "position": (-1.2, 1.6, -0.6)}],
        "environment": {"map": "uniform", "size": (8, 16)},
    }
    camera = {"size": (24, 32), "azimuth": 0.4, "elevation": 0.7, "distance": 2.6}
    return resolve(
        Scene.model_validate({"camera": camera, "lights": lights, "objects": objects, "shadows": {}} | more), library
    )


def image(kind: str, of: ResolvedScene) -> Tensor:
    if kind == "pyrender":
        return PyrenderRenderer(of).exact().render({})[0]
    # Outlines as without a floor, where a pixel shows the mean of its surfaces.
    return TorchRenderer(of, replace(rasterise(of), fragments=None), tolerance="exact").render({})[0]


@pytest.mark.parametrize("kind", ["torch", "pyrender"])
def test_a_floor_receives_the_shadows_of_the_same_square_as_an_object(kind: str, library: Library) -> None:
    found = image(kind, scene(library, BALL, floor=FLOOR))
    same = image(kind, scene(library, BALL, SQUARE))
    plain = image(kind, scene(library, BALL, floor=FLOOR, shadows=None))
    # A sample at an edge may fall to the other side, as the corners are rounded to float32 in another space.
    assert float(((found - same).abs().amax(-1) > 2e-3).double().mean()) < 0.02
    darker = plain - found
    assert float(darker.min()) > -1e-6
    assert float((darker.amax(-1) > 0.02).double().mean()) > 0.03


def test_a_floor_s_light_and_normals_are_attacked_in_shadow(library: Library) -> None:
    of = scene(library, BALL, floor=FLOOR)
    drawn = rasterise(of)
    renderer = TorchRenderer(of, drawn, ("normals", "illumination"), tolerance="exact")
    values = {g: renderer.initial()[g][None].requires_grad_() for g in ("normals", "illumination")}
    on_floor = drawn.object_index == 1
    renderer.render(values)[0][on_floor].sum().backward()
    normals, light = values["normals"].grad, values["illumination"].grad
    assert normals is not None
    assert light is not None
    assert bool((normals[0][on_floor].abs().amax(-1) > 0).double().mean() > 0.9)
    assert bool(torch.count_nonzero(light) > light.numel() / 4)
