"""Both renderers show the same background, and gradients do not know of it."""

from typing import Any

import pytest
import torch

from scene_attack.rendering.factory import build
from scene_attack.rendering.protocol import Renderer
from scene_attack.runs.spec import parse
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.jobs.small import LIBRARY, SPHERE
from tests.unit.scenes.test_background import picture

pytestmark = pytest.mark.slow

SMALL = {"objects": [{"mesh": "primitive/sphere", "scale": 0.5}]}


def scene_with(background: dict[str, Any] | None, **changes: Any) -> ResolvedScene:
    return resolve(parse({"scene": SPHERE | SMALL | {"background": background} | changes}).scene, LIBRARY)


def renderer(name: str, scene: ResolvedScene) -> Renderer:
    return build(scene, name, None, ("normals",) if name == "torch" else ("camera", "color"), 1e-3)


def image(name: str, scene: ResolvedScene) -> torch.Tensor:
    return renderer(name, scene).exact().render({})[0].float()


@pytest.mark.parametrize("background", [{}, {"image": picture()}], ids=["map", "picture"])
def test_both_renderers_show_it_where_no_object_is_and_blend_it_at_outlines(background: dict[str, Any]) -> None:
    scene = scene_with(background)
    behind = torch.as_tensor(scene.ground).float()
    for name in ("torch", "pyrender"):
        black, white = (image(name, scene_with(None, ground=[value] * 3)) for value in (0, 1))
        coverage = 1 - (white - black)  # of each pixel, the share that the object covers
        assert (coverage < 1e-6).float().mean() > 0.5
        expected = black + (1 - coverage) * behind
        assert (image(name, scene) - expected).abs().max() < 1e-5


def test_a_map_moves_with_the_camera_and_a_picture_does_not() -> None:
    moved = {"camera": torch.tensor([[1.4, 0.3, 1.8, 0.2], [0.61, 0.3490658503988659, 1.8, 0.0]], dtype=torch.float64)}
    with_map = scene_with({})
    for one in (renderer("pyrender", with_map), renderer("pyrender", with_map).exact()):
        there, back = one.render(moved)
        assert torch.equal(back, one.render({})[0])
        edge = there[0] - back[0]  # the first row shows no object
        assert edge.abs().max() > 0.02
    again = resolve(
        parse(
            {
                "scene": SPHERE
                | SMALL
                | {"background": {}, "camera": {"size": [64, 64], "azimuth": 1.4, "elevation": 0.3}}
            }
        ).scene,
        LIBRARY,
    )
    moved["camera"] = torch.tensor([[1.4, 0.3, 1.8, 0.0]], dtype=torch.float64)
    shown = renderer("pyrender", with_map).exact().render(moved)[0]
    assert (shown - image("pyrender", again)).abs().max() < 2 / 255
    still = renderer("pyrender", scene_with({"image": picture()})).exact()
    assert torch.equal(still.render(moved)[0][0], still.render({})[0][0])


@pytest.mark.parametrize("background", [None, {}], ids=["colour", "map"])
def test_gradients_are_those_of_differences(background: dict[str, Any] | None) -> None:
    drawn = renderer("torch", scene_with(background)).exact()
    start = drawn.initial()["normals"][None].double()
    weights = torch.randn(64, 64, 3, generator=torch.Generator().manual_seed(1)).double()
    normals = start.clone().requires_grad_(True)
    (drawn.render({"normals": normals})[0] * weights).sum().backward()
    gradient = normals.grad
    assert gradient is not None
    direction = torch.randn(start.shape, generator=torch.Generator().manual_seed(2)).double()
    step = 1e-5
    ends = [(drawn.render({"normals": start + sign * step * direction})[0] * weights).sum() for sign in (1, -1)]
    slope = float((ends[0] - ends[1]) / (2 * step))
    assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("name", ["torch", "pyrender"])
def test_a_plain_background_is_the_ground_to_the_bit(name: str) -> None:
    """A picture of the ground's colour gives the image of the ground."""
    import base64
    from io import BytesIO

    from PIL import Image

    buffer = BytesIO()
    Image.new("RGB", (64, 64), (128, 128, 128)).save(buffer, format="PNG")
    same = scene_with({"image": base64.b64encode(buffer.getvalue()).decode()})
    assert (image(name, same) - image(name, scene_with(None))).abs().max() <= 1e-6
