"""Scenes as stock pyrender draws their exports, against our pyrender renderer."""

from typing import Any

import pytest
import torch
from torch import Tensor

from scene_attack.errors import JobFailure
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.factory import build
from scene_attack.rendering.protocol import Renderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import ResolvedScene, resolve
from scene_attack_stock import renderer as stock
from tests.unit.jobs.small import LIBRARY

SUN = {"ambient": 0.0, "points": [], "directional": [{"energy": 3.0, "direction": [-0.3, -0.5, -1.0]}]}


def scene(lights: dict[str, Any] = SUN, **thing: Any) -> ResolvedScene:
    described = {"mesh": "primitive/torus", "rotation": [0.6, 0.3, 0.0], "metallic": 0.0, "roughness": 0.6} | thing
    whole = {"camera": {"size": [96, 80]}, "objects": [described], "lights": lights, "ground": [0.0, 0.0, 1.0]}
    return resolve(Scene.model_validate(whole), LIBRARY)


def drawn(renderer: Renderer, **values: list[Any]) -> Tensor:
    """The image, uint8 [H, W, 3], of values by group; the scene's own for all others."""
    groups = {group: torch.tensor(value, dtype=torch.float64)[None] for group, value in values.items()}
    return to_bytes(renderer.render(groups)[0])


def linear(image: Tensor, curve: float | None) -> Tensor:
    """Linear light of displayed values, by a power or by the sRGB curve."""
    shown = image.double() / 255
    if curve is not None:
        return shown**curve
    return torch.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def test_light_and_outlines_are_those_of_our_renderer() -> None:
    """Both shade glTF's material under one sun by Schlick's and Smith's terms, in forms that differ by a few percent;
    an energy, a pose or a camera that were read wrongly would be off by far more."""
    theirs, ours = (drawn(build(scene(), name, tolerance="exact")) for name in ("stock-pyrender", "pyrender"))
    covered = (ours[..., 2] != 255) & (theirs[..., 2] != 255)
    assert 1500 < int(covered.sum()) < 5000
    assert int(((ours[..., 2] != 255) != (theirs[..., 2] != 255)).sum()) < 0.02 * int(covered.sum())
    light, expected = linear(theirs, 2.2)[covered], linear(ours, None)[covered]
    bright = expected > 0.1
    assert float((light[bright] / expected[bright] - 1).abs().median()) < 0.03
    assert float(light[bright].mean() / expected[bright].mean()) == pytest.approx(1.0, abs=0.03)


def test_a_change_is_that_of_the_scene_with_it() -> None:
    changed = scene(translation=[0.1, -0.05, 0.2], color=[0.5, 1.0, 0.25])
    expected = drawn(build(changed, "stock-pyrender"))
    found = drawn(build(scene(), "stock-pyrender"), translation=[[0.1, -0.05, 0.2]], color=[[0.5, 1.0, 0.25]])
    assert torch.equal(found, expected)


def test_images_of_a_batch_are_those_of_each_alone() -> None:
    renderer = build(scene(), "stock-pyrender")
    turns = torch.tensor([[[0.6, 0.3, 0.0]], [[0.1, 0.0, 0.4]]], dtype=torch.float64)
    both = renderer.render({"rotation": turns})
    assert torch.equal(both[1], renderer.render({"rotation": turns[1:]})[0])
    assert torch.equal(both[0], renderer.render({})[0])


@pytest.mark.parametrize(
    ("body", "kind", "said"),
    [
        ("raise SystemExit(3)", "internal", "ended with code 3"),
        ("import os; os.kill(os.getpid(), 9)", "internal", "ended with code -9"),
        ("while True: pass", "timeout", "took more than 1 seconds"),
    ],
)
def test_a_process_that_fails_ends_with_a_reason(
    body: str, kind: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    renderer = build(scene(), "stock-pyrender")
    python = stock.program("x")[0]
    monkeypatch.setattr(stock, "program", lambda *_: [python, "-c", body])
    monkeypatch.setattr(stock, "SECONDS_PER_IMAGE", 1.0)
    with pytest.raises(JobFailure, match=said) as failed:
        renderer.render({})
    assert failed.value.kind == kind
