"""Textures finer than the pixels are averaged as light, not as stored sRGB values, however a surface is divided."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from benchmarks.gltf_materials import View
from scene_attack.client.meshes import bundle_at
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import SceneObject
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import Part
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import DEFAULTS
from tests.unit.rendering.pyrender.rasterised_scenes import rasterised
from tests.unit.rendering.shapes import mesh, part, placed, scene

SQUARE = """mtllib a.mtl
v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl a
f 1/1 2/2 3/3
f 1/1 3/3 4/4
"""


def radiance(folder: Path, texels: NDArray[np.uint8]) -> NDArray[np.float64]:
    """The mean diffuse radiance [3] of a square with this texture, at 64 × 64 pixels, where a pixel sees only it."""
    folder.mkdir()
    (folder / "a.obj").write_text(SQUARE)
    (folder / "a.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd lines.png\n")
    Image.fromarray(texels).save(folder / "lines.png")
    library = Library(folder / "cache", folder / "data")
    mesh = library.add(bundle_at(folder / "a.obj", DEFAULTS)).name
    scene = View("-", "directional").scene
    camera = scene.camera.model_copy(update={"size": (64, 64)})
    scene = scene.model_copy(
        update={"camera": camera, "objects": (SceneObject(mesh=mesh, roughness=1.0, metallic=0.0),)}
    )
    image = PyrenderRenderer(resolve(scene, library)).radiance({})[0].double().numpy()
    return np.asarray(image[image[..., 3] == 1][:, :3].mean(axis=0))


@pytest.mark.parametrize("every", [2, 4])
def test_white_lines_are_their_share_of_white(tmp_path: Path, every: int) -> None:
    """Averaged as sRGB, a line in four would be a quarter of the displayed value, a twentieth of the light."""
    black = np.zeros((256, 256, 3), np.uint8)
    lines = black.copy()
    lines[:, ::every] = 255
    dark, lined, white = (
        radiance(tmp_path / str(k), texels) for k, texels in enumerate((black, lines, np.full_like(black, 255)))
    )
    assert (lined - dark) / (white - dark) == pytest.approx(1 / every, rel=0.03)


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


@pytest.mark.usefixtures("software_opengl")
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
