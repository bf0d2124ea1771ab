"""Textures finer than the pixels are averaged as light, not as the sRGB values that are stored."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from benchmarks.gltf_materials import View
from client.specs import bundle_at
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.description import SceneObject
from services.scenes.library import Library
from services.scenes.resolve import resolve
from services.settings import DEFAULTS

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
