"""The detail of a texture that an image shows does not depend on how finely a surface is divided into triangles."""

import numpy as np
import pytest
from numpy.typing import NDArray

from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.mesh import Part
from tests.unit.rendering.pyrender_renderer.rasterised_scenes import rasterised
from tests.unit.rendering.shapes import mesh, part, placed, scene

pytestmark = pytest.mark.usefixtures("software_opengl")

SIDE = 0.4


def lines() -> NDArray[np.uint8]:
    """A line in eight texels, at right angles to each other."""
    texture = np.full((256, 256, 4), 255, np.uint8)
    texture[..., :3] = 20
    texture[::8, :, :3] = texture[:, ::8, :3] = 255
    return texture


def divided(steps: int) -> Part:
    """A square of `steps`² squares of two triangles each, with the texture of `lines` over all of it."""
    t = np.linspace(0, 1, steps + 1)
    uv = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    vertices = np.concatenate([SIDE * (2 * uv - 1), np.zeros((len(uv), 1))], axis=1)
    first = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).reshape(-1, 1)
    faces = np.concatenate([first + np.array(corners) for corners in ((0, 1, steps + 2), (0, steps + 2, steps + 1))])
    return part(vertices, faces, [[0, 0, 1]] * len(uv), uv=uv, texture=lines())


@pytest.mark.parametrize("rasterise", [False, True], ids=["OpenGL", "rasteriser"])
def test_small_triangles_show_the_texture_as_large_ones_do(rasterise: bool) -> None:
    images = []
    for steps in (1, 41):
        made = placed(scene((96, 96)), mesh(divided(steps)))
        renderer = rasterised(made) if rasterise else PyrenderRenderer(made).exact()
        images.append(renderer.radiance({})[0].numpy())
    large, small = images
    inside = (large[..., 3] == 1) & (small[..., 3] == 1)
    assert inside.sum() > 2000
    assert large[inside].std() > 0, "the lines show"
    assert np.abs(small - large)[inside].max() < 1e-3 * large[inside].max()
