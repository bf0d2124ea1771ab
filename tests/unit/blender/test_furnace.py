"""A white furnace: an object that reflects all light disappears in light that is the same all around."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from scene_attack.scenes.description import Lights
from scene_attack_blender.process import BlenderProcess, StagedScene
from scene_attack_blender.renderer import staged
from tests.unit.path_tracing.agreement import tracer, values_of
from tests.unit.rendering import shapes

pytestmark = pytest.mark.slow


SKY = 0.7


def drawn(surface: Any, bounces: int, blender: BlenderProcess, **part: Any) -> np.ndarray:
    """The image [H, W, 4] of a white sphere, or of a torus that lights itself, under an even sky."""
    scene = shapes.placed(shapes.scene((48, 48), lights=Lights(ambient=SKY, points=())), surface)
    own = tracer("blender", scene, samples=1024, bounces=bounces)
    whole = staged(scene, own.bounces)
    parts = [{**described, **part} for described in whole.described["parts"]]
    even = StagedScene({**whole.described, "sky_gradient": 0.0, "parts": parts}, whole.arrays)
    frame = {name: np.asarray(value).tolist() for name, value in vars(own.frame(values_of(own, {}))).items()}
    return blender.image(even, frame | {"samples": own.samples, "seed": 0}).reshape(48, 48, 4).astype(float)


def facing_pair() -> Any:
    """Two squares that face each other, so that each lights the other."""
    near = shapes.quad(0.4, centre=(0, 0, -0.3))
    mirror = np.array([1, 1, -1], np.float32)
    far = replace(near, vertices=near.vertices * mirror, normals=-near.normals, faces=near.faces[:, ::-1])
    turn = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float32)
    return shapes.mesh(*(replace(p, vertices=p.vertices @ turn, normals=p.normals @ turn) for p in (near, far)))


@pytest.mark.parametrize(("mesh", "bounces"), [("sphere", 0), ("pair", 64)])
def test_a_white_body_disappears(process: BlenderProcess, mesh: str, bounces: int) -> None:
    surface = shapes.mesh(shapes.sphere()) if mesh == "sphere" else facing_pair()
    image = drawn(surface, bounces, process, coated=False)
    whole = image[..., 3] > 1 - 1e-6
    assert whole.sum() > 100
    off = image[whole][:, :3] / SKY - 1
    # the triangles of a sphere hide a little of the sky from its bent normals at the rim
    assert abs(off.mean()) < 0.002
    assert np.abs(off).max() < 0.02


def test_without_bounces_what_faces_each_other_is_darker(process: BlenderProcess) -> None:
    image = drawn(facing_pair(), 0, process, coated=False)
    assert (image[image[..., 3] > 1 - 1e-6][:, 0] < 0.9 * SKY).any()
