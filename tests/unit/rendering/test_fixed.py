"""What is fixed in a scene looks as it does among the objects, and no group has a coordinate of it.

The reference is the same scene with the fixed things last among its objects, which the renderers draw in that order.
"""

from typing import Any

import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.pose import MovingCamera
from scene_attack.rendering.protocol import Renderer
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene, canonical_json, resolve
from tests.unit.jobs.small import LIBRARY

BALL = {"mesh": "primitive/sphere", "scale": 0.6, "color": (0.9, 0.4, 0.2), "material": "plastic"}
CUBE = {
    "mesh": "primitive/cube",
    "translation": (0.4, 0.1, -0.7),
    "rotation": (0.2, 0.5, 0.0),
    "color": (0.2, 0.6, 0.9),
}
CAMERA = {"size": (40, 56), "azimuth": 0.5, "elevation": 0.4, "distance": 2.4}
LIGHTS = {"environment": {"map": "uniform", "size": (8, 16)}}


def scene(*objects: dict[str, Any], **more: Any) -> ResolvedScene:
    given = {"camera": CAMERA, "lights": LIGHTS, "objects": objects, "shadows": {"resolution": 256}} | more
    return resolve(Scene.model_validate(given), LIBRARY)


def drawn(made: ResolvedScene, renderer: str) -> Renderer:
    if renderer == "pyrender":
        return PyrenderRenderer(made)
    # Outlines as among objects, where a pixel shows the mean of its surfaces.
    whole = rasterise(made)
    return TorchRenderer(made, type(whole)(**{**vars(whole), "fragments": None}))


@pytest.mark.parametrize("renderer", ["pyrender", "torch"])
@pytest.mark.parametrize("more", [{}, {"floor": {"height": -0.4}}])
def test_it_is_drawn_to_the_bit_as_among_the_objects_with_its_shadows(renderer: str, more: dict[str, Any]) -> None:
    fixed, free, alone = scene(BALL, fixed=[CUBE], **more), scene(BALL, CUBE, **more), scene(BALL, **more)
    images = [drawn(made, renderer).exact().render({})[0] for made in (fixed, free, alone)]
    assert torch.equal(images[0], images[1])
    assert float((images[0] - images[2]).abs().amax(-1).gt(0.01).double().mean()) > 0.05


@pytest.mark.parametrize("renderer", ["pyrender", "torch"])
def test_no_group_has_a_coordinate_of_it(renderer: str) -> None:
    fixed, alone = (drawn(made, renderer).initial() for made in (scene(BALL, fixed=[CUBE]), scene(BALL)))
    of_pixels = ("normals",)  # which every surface has, as a floor's do
    shapes = [{g: value.shape for g, value in groups.items() if g not in of_pixels} for groups in (fixed, alone)]
    assert shapes[0] == shapes[1]


def test_the_camera_may_come_nearer_than_it_but_always_sees_all_of_it() -> None:
    room = {"mesh": "primitive/cube", "scale": 8}
    made = scene(BALL, fixed=[room])
    lowest, highest = MovingCamera(made).bounds
    far = made.projection[2, 3] / (made.projection[2, 2] + 1)
    assert lowest[2] < 8 * FIT_RADIUS
    assert float(highest[2]) == pytest.approx(far - 8 * FIT_RADIUS)


def test_it_is_part_of_the_digest_and_left_out_where_there_is_none() -> None:
    plain = Scene.model_validate({"objects": [BALL]})
    assert "fixed" not in canonical_json(plain)
    moved = CUBE | {"translation": (0.5, 0.1, -0.7)}
    assert len({scene(BALL).sha256, scene(BALL, fixed=[CUBE]).sha256, scene(BALL, fixed=[moved]).sha256}) == 3


def test_an_object_that_it_hides_is_refused_and_a_mesh_that_there_is_not_is_named() -> None:
    wall = {"mesh": "primitive/cube", "translation": (0.5, 0.5, 1.0)}
    with pytest.raises(InvalidRequest, match=r"scene\.objects: out of view"):
        rasterise(scene(BALL | {"scale": 0.1}, fixed=[wall]))
    with pytest.raises(InvalidRequest, match=r"scene\.fixed\.0\.mesh: there is no mesh 'primitive/cub'"):
        scene(BALL, fixed=[{"mesh": "primitive/cub"}])
