"""The comparison of docs/stock-pyrender.md, on a small model of the test's own."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks import own_meshes
from benchmarks.fine_images import averaged, blocks, displayed, light

pytestmark = pytest.mark.slow

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


@pytest.fixture
def striped(tmp_path: Path) -> Path:
    """A square whose texture has a white line in every four texels, finer than the pixels of the image."""
    (tmp_path / "a.obj").write_text(SQUARE)
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd lines.png\n")
    texels = np.zeros((256, 256, 3), np.uint8)
    texels[:, ::4] = 255
    Image.fromarray(texels).save(tmp_path / "lines.png")
    return tmp_path / "a.obj"


def test_lines_finer_than_a_pixel_are_told_from_every_other_reason(
    striped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Averaged as sRGB, a line in four is a quarter of the displayed value, and not of the light."""
    camera = own_meshes.SCENE.camera.model_copy(update={"size": (64, 64)})
    monkeypatch.setattr(own_meshes, "SCENE", own_meshes.SCENE.model_copy(update={"camera": camera}))
    [row], backend = own_meshes.compared([striped])
    assert "OpenGL" in backend
    assert row["used"] == ("material library a.mtl", "texture lines.png")
    assert row["mean"] > 10
    assert row["mended"]["mean"] > 10, "no omission of stock pyrender's is the reason"
    assert row["alike"]["mean"] < 0.5
    assert row["alike_fine"]["mean"] < 0.5
    assert row["light"]["ours"]["mean"] < 2 < 10 < row["light"]["stock"]["mean"]


def test_what_is_averaged_is_light_and_not_what_displays_it() -> None:
    checks = np.indices((4, 4)).sum(axis=0) % 2
    shown = np.repeat(255 * checks[..., None], 3, axis=-1).astype(np.uint8)
    everywhere = np.ones((4, 4), bool)
    grey = round(255 * 0.5 ** (1 / 2.2))
    assert (displayed(averaged(light(shown, everywhere), 4)) == grey).all()
    assert (blocks(shown, 2) == grey).all()
    # Where only the white checks are surface, half of a pixel is white and the other half is the ground.
    assert (displayed(averaged(light(shown, checks > 0), 4)) == 128).all()
    # What is brighter than a display is no brighter than white.
    strong = np.ones((2, 2, 4))
    strong[0] = (10, 10, 10, 1)
    strong[1] = (0, 0, 0, 1)
    assert (displayed(averaged(strong, 2)) == grey).all()


def test_an_image_as_large_as_it_is_shown_is_what_was_drawn() -> None:
    values = np.random.default_rng(0).integers(0, 256, (8, 8, 3), dtype=np.uint8)
    assert (displayed(light(values, np.ones((8, 8), bool))) == values).all()
