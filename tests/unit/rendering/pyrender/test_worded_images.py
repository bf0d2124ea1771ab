"""What sentences say is what the images show: a thing that "moved right" is farther right in the image, and so on."""

from math import atan2, pi

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from scene_attack.rendering.factory import build
from scene_attack.rendering.physical_change import changes_in_words
from scene_attack.rendering.protocol import Renderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.jobs.small import LIBRARY

SIZE = 64
UPRIGHT, LYING = (0.0, 0.0, 0.0), (pi / 2, 0.0, 0.0)
"""Poses of a cylinder whose axis is +y: along +y and along +z."""


def drawn(rotation: tuple[float, float, float] = UPRIGHT, **camera: float) -> tuple[ResolvedScene, Renderer]:
    """A narrow cylinder and its exact renderer."""
    described = {
        "camera": {"size": [SIZE, SIZE], "azimuth": 0.0, "elevation": 0.0} | camera,
        "objects": [{"mesh": "primitive/cylinder", "rotation": rotation, "scale": 0.6, "color": [0.5, 0.5, 0.5]}],
    }
    scene = resolve(Scene.model_validate(described), LIBRARY)
    return scene, build(scene, "pyrender", tolerance="exact").exact()


def image(renderer: Renderer, **change: Tensor) -> Tensor:
    initial = renderer.initial()
    return renderer.render({group: (initial[group] + value)[None] for group, value in change.items()})[0]


def mask(renderer: Renderer, **change: Tensor) -> Tensor:
    """The pixels [H, W] that the cylinder covers at least in part."""
    away = {"translation": torch.tensor([[0.0, 1e4, 0.0]], dtype=torch.float64)}
    nothing = renderer.render({"translation": away["translation"][None]})[0]
    return ((image(renderer, **change) - nothing).abs() > 1e-3).any(dim=-1)


def centre(covered: Tensor) -> tuple[float, float]:
    """Mean place of the pixels: to the right, and up."""
    rows, columns = torch.where(covered)
    return float(columns.double().mean()), -float(rows.double().mean())


def lean(covered: Tensor) -> float:
    """Angle of the longest axis of the pixels from the horizontal, anticlockwise, in [0, π), radians."""
    rows, columns = torch.where(covered)
    x, y = columns.double() - columns.double().mean(), -(rows.double() - rows.double().mean())
    return atan2(2 * float((x * y).mean()), float((x * x - y * y).mean())) / 2 % pi


def sentence(scene: ResolvedScene, renderer: Renderer, **change: Tensor) -> str:
    [found] = changes_in_words(scene, renderer, change)
    return found.sentence


def along(direction: tuple[float, float, float], size: float) -> Tensor:
    return torch.tensor([direction], dtype=torch.float64) * size


@pytest.mark.parametrize("azimuth", [0.0, 2.1])
@pytest.mark.parametrize(
    ("axis", "words"),
    [(0, ("left", "right")), (1, ("down", "up")), (2, ("away from the camera", "towards the camera"))],
)
def test_a_move_goes_where_its_sentence_says(azimuth: float, axis: int, words: tuple[str, str]) -> None:
    scene, renderer = drawn(azimuth=azimuth, elevation=0.3)
    for sign, word in ((-1, words[0]), (1, words[1])):
        change = torch.from_numpy(sign * 0.2 * scene.view[:3, axis])[None]
        assert sentence(scene, renderer, translation=change).startswith("moved 0.2 scene units " + word)
        old, new = mask(renderer), mask(renderer, translation=change)
        larger = float(new.sum() - old.sum())  # what comes nearer is
        assert np.sign(larger if axis == 2 else centre(new)[axis] - centre(old)[axis]) == sign


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_turn_in_the_image(sign: int) -> None:
    scene, renderer = drawn(azimuth=0.8)
    change = torch.from_numpy(sign * 0.2 * scene.view[:3, 2])[None]
    word = "anticlockwise" if sign > 0 else "clockwise"
    assert sentence(scene, renderer, rotation=change) == f"turned 11° {word} in the image"
    assert lean(mask(renderer, rotation=change)) - lean(mask(renderer)) == pytest.approx(0.2 * sign, abs=0.06)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_turn_seen_from_above(sign: int) -> None:
    scene, renderer = drawn(LYING, elevation=pi / 2)
    after = Rotation.from_rotvec([0.0, 0.2 * sign, 0.0]) * Rotation.from_rotvec(LYING)
    change = torch.from_numpy(after.as_rotvec() - np.array(LYING))[None]
    word = "anticlockwise" if sign > 0 else "clockwise"
    assert sentence(scene, renderer, rotation=change) == f"turned 11° {word} seen from above"
    assert lean(mask(renderer, rotation=change)) - lean(mask(renderer)) == pytest.approx(0.2 * sign, abs=0.06)


@pytest.mark.parametrize(("sign", "word"), [(1, "towards the camera"), (-1, "away from the camera")])
def test_what_tips_towards_the_camera_is_wider_at_its_top(sign: int, word: str) -> None:
    scene, renderer = drawn(distance=1.0)
    change = along((1.0, 0.0, 0.0), 0.3 * sign)
    assert sentence(scene, renderer, rotation=change) == f"tipped 17° {word}"
    covered = mask(renderer, rotation=change)
    rows = torch.where(covered.any(dim=1))[0]
    middle = int(rows.double().mean())
    assert np.sign(float(covered[:middle].sum() - covered[middle + 1 :].sum())) == sign


@pytest.mark.parametrize(("factor", "word"), [(0.77, "23 % dimmer"), (1.5, "50 % brighter")])
def test_light(factor: float, word: str) -> None:
    scene, renderer = drawn()
    change = renderer.initial()["illumination"] * (factor - 1)
    change[1:] = 0
    [ambient, *lamps] = changes_in_words(scene, renderer, {"illumination": change})
    assert (ambient.subject, ambient.sentence) == ("ambient light", word)
    assert {one.sentence for one in lamps} == {"as bright as before and did not move"}
    brighter = float((image(renderer, illumination=change) - image(renderer)).mean())
    assert np.sign(brighter) == np.sign(factor - 1)


def test_colours() -> None:
    scene, renderer = drawn()
    change = torch.tensor([[-0.07, 0.0, 0.05]], dtype=torch.float64)  # of 0.5
    assert sentence(scene, renderer, color=change) == "red −14 %, green 0 %, blue +10 %"
    moved = (image(renderer, color=change) - image(renderer)).mean(dim=(0, 1))
    assert moved.sign().tolist() == [-1, 0, 1]


@pytest.mark.parametrize("sign", [-1, 1])
def test_the_camera(sign: int) -> None:
    """What the camera moves away from is smaller; when it rolls to its left, what was upright leans to the right."""
    scene, renderer = drawn(elevation=0.2)
    farther = torch.tensor([0.0, 0.0, 0.3 * sign, 0.0], dtype=torch.float64)
    word = "farther" if sign > 0 else "nearer"
    assert sentence(scene, renderer, camera=farther) == f"moved 0.3 scene units {word}"
    assert np.sign(float(mask(renderer).sum() - mask(renderer, camera=farther).sum())) == sign
    roll = torch.tensor([0.0, 0.0, 0.0, 0.1 * sign], dtype=torch.float64)
    assert sentence(scene, renderer, camera=roll) == f"rolled 5.7° to its {'left' if sign > 0 else 'right'}"
    assert lean(mask(renderer, camera=roll)) - lean(mask(renderer)) == pytest.approx(-0.1 * sign, abs=0.06)
    up = torch.tensor([0.0, 0.1 * sign, 0.0, 0.0], dtype=torch.float64)
    assert sentence(scene, renderer, camera=up) == f"moved 5.7° {'up' if sign > 0 else 'down'} around the scene"
