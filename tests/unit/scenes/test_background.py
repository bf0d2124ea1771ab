"""The environment map and pictures behind a scene's objects, against closed forms and the torch renderer's exposure."""

import base64
from io import BytesIO
from math import pi

import numpy as np
import pytest
from PIL import Image

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.torch.light import illumination
from scene_attack.runs.spec import parse
from scene_attack.scenes.description import MAX_PICTURE, Camera, Scene
from scene_attack.scenes.environment import average
from scene_attack.scenes.image_file import to_display
from scene_attack.scenes.resolve import canonical_json, displayed_map, exposure_of, resolve
from scene_attack.scenes.view import camera_pose, projection
from tests.unit.jobs.small import LIBRARY, SPHERE

SIZE = (40, 60)
RANDOM = np.random.default_rng(4).uniform(0.1, 3.0, (16, 32, 3)).astype(np.float32)


def clip_from_world(azimuth: float, elevation: float = 0.0, roll: float = 0.0) -> np.ndarray:
    lens = projection(Camera(size=SIZE, field_of_view=0.4), 50.0)
    return lens @ np.linalg.inv(camera_pose(azimuth, elevation, 1.8, roll))


def picture(size: tuple[int, int] = (64, 64)) -> str:
    buffer = BytesIO()
    values = np.random.default_rng(5).integers(0, 256, (*size, 3), np.uint8)
    Image.fromarray(values).save(buffer, format="PNG")
    return base64.b64encode(buffer.getvalue()).decode()


def scene(**changes: object) -> Scene:
    return parse({"scene": SPHERE | changes}).scene


def test_objects_and_background_have_the_exposure_of_the_torch_renderer() -> None:
    import torch

    light = illumination(torch.as_tensor(RANDOM))
    shown = light.exposure * light.chroma * light.intensity[..., None]
    assert np.allclose(shown.numpy(), exposure_of(RANDOM) * RANDOM.astype(np.float64), rtol=1e-9)
    assert exposure_of(np.zeros_like(RANDOM)) == 0


@pytest.mark.parametrize("azimuth", [0.0, 1.3, -2.0])
def test_the_middle_of_the_image_is_the_texel_that_the_camera_looks_at(azimuth: float) -> None:
    # The camera is at `azimuth` and looks at the origin, so towards the opposite azimuth. A map of which only a few
    # columns of texels are bright shows a bright stripe in the middle.
    cols = 720
    bright = np.zeros((90, cols, 3), np.float32)
    col = round(((azimuth + pi) % (2 * pi)) / (2 * pi) * cols - 0.5)
    bright[:, col - 4 : col + 5] = 1.0
    seen = displayed_map(bright, 1.0, 0.0, clip_from_world(azimuth), SIZE)
    middle = seen[:, :, 0].mean(axis=0)
    assert middle[29:31].min() > 0.99
    assert middle[:20].max() == middle[40:].max() == 0
    assert np.array_equal(seen, np.round(seen * 255) / 255)


@pytest.mark.parametrize("azimuth", [0.2, 1.7, -2.1])
def test_between_texels_a_map_is_a_straight_line(azimuth: float) -> None:
    """Radiance that is linear in the azimuth around what the camera looks at: half a texel off is 6 of 255 off."""
    cols = 16
    towards = azimuth + pi
    away = np.mod((np.arange(cols) + 0.5) * 2 * pi / cols - towards + pi, 2 * pi) - pi
    linear = (0.4 + 0.1 * away).astype(np.float32)
    seen = displayed_map(np.repeat(linear[None, :, None], 8, 0).repeat(3, 2), 1.0, 0.0, clip_from_world(azimuth), SIZE)
    middle = seen[:, 29:31, 0].mean()
    assert abs(middle - to_display(np.array(0.4))) < 1.5 / 255  # the two columns are half a pixel aside, and rounded


def test_up_is_up_and_right_is_right() -> None:
    rows = np.linspace(0, 1, 90, dtype=np.float32)  # dark above, bright below
    vertical = displayed_map(np.repeat(rows[:, None, None], 8, 1).repeat(3, 2), 1.0, 0.0, clip_from_world(0.4), SIZE)
    assert vertical[0].mean() < vertical[-1].mean()
    # From +z the camera looks towards -z, with +x (azimuth π/2) on its right; from -z with +x on its left.
    towards_x = np.clip(np.sin((np.arange(360) + 0.5) * pi / 180), 0, 1).astype(np.float32)
    horizontal = np.repeat(towards_x[None, :, None], 90, 0).repeat(3, 2)
    from_z = displayed_map(horizontal, 1.0, 0.0, clip_from_world(0.0), SIZE)
    assert from_z[:, -1].mean() > from_z[:, 0].mean()


def test_turning_the_map_is_what_averaging_turns_it() -> None:
    turned = average(RANDOM, 16, 32, 2 * pi / 32 * 5)
    seen = displayed_map(RANDOM, 0.2, 2 * pi / 32 * 5, clip_from_world(0.7), SIZE)
    assert np.abs(seen - displayed_map(turned, 0.2, 0.0, clip_from_world(0.7), SIZE)).max() <= 1 / 255


def test_an_even_map_is_an_even_background() -> None:
    found = resolve(scene(background={}, lights={"environment": {"map": "uniform"}}), LIBRARY)
    assert np.unique(found.ground) == pytest.approx([round(float(to_display(np.array(0.9))) * 255) / 255], abs=1 / 255)


def test_a_scene_without_a_background_keeps_its_description() -> None:
    assert "background" not in canonical_json(scene())
    assert resolve(scene(), LIBRARY).ground.tolist() == list(scene().ground)


def test_a_picture_is_behind_the_objects_and_part_of_the_digest() -> None:
    one = resolve(scene(background={"image": picture()}), LIBRARY)
    with Image.open(BytesIO(base64.b64decode(picture()))) as image:
        assert np.array_equal(one.ground, np.asarray(image) / 255)
    assert len({one.sha256, resolve(scene(), LIBRARY).sha256, resolve(scene(background={}), LIBRARY).sha256}) == 3


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (picture((32, 64)), "the camera of the scene has 64×64"),
        ("no base64!", "not base64"),
        (base64.b64encode(b"GIF89a").decode(), "PNG JPEG or WebP"),
        ("A" * (MAX_PICTURE + 4), str(MAX_PICTURE)),
    ],
)
def test_a_picture_that_cannot_be_used_is_refused_by_its_field(image: str, said: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        resolve(scene(background={"image": image}), LIBRARY)
    assert refused.value.field == "scene.background.image"
    assert said in refused.value.detail.replace(",", "")
