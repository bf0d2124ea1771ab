"""Overlaps against a search for a separating plane; what is refused, and where."""

from dataclasses import replace
from itertools import product
from math import cos, radians, sin

import numpy as np
import pytest

from services.errors import InvalidRequest
from services.scenes.clevr.generator import Placed, check, generate, overlap, placed_in
from services.scenes.clevr.records import Rig, half_height

SHAPES = ("cube", "sphere", "cylinder")


def standing(shape: str, size: str, x: float, y: float, rotation: float = 0.0) -> Placed:
    return Placed(shape, size, "red", "metal", (x, y, half_height(shape, size)), rotation)


def directions() -> np.ndarray:
    """Unit vectors, one in each degree of both angles of the upper half of a sphere."""
    turn, height = np.meshgrid(np.arange(0, 360) * np.pi / 180, np.arange(-45, 46) * np.pi / 180)
    flat = np.cos(height)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(height)], -1).reshape(-1, 3)


def extent(one: Placed, along: np.ndarray) -> np.ndarray:
    """How far a solid reaches from its centre in each direction."""
    radius = {"small": 0.35, "large": 0.7}[one.size]
    if one.shape == "sphere":
        return np.full(len(along), radius)
    if one.shape == "cylinder":
        return radius * (np.hypot(along[:, 0], along[:, 1]) + abs(along[:, 2]))
    angle, half = radians(one.rotation), radius / 2**0.5
    axes = np.array([[cos(angle), sin(angle), 0], [-sin(angle), cos(angle), 0], [0, 0, 1]])
    return half * abs(along @ axes.T).sum(1)


def gap(one: Placed, other: Placed) -> float:
    """The largest gap between the projections of two solids on a direction; below 0 no plane separates them."""
    along = directions()
    return float((along @ np.subtract(other.centre, one.centre) - extent(one, along) - extent(other, along)).max())


@pytest.mark.parametrize(("first", "second"), list(product(SHAPES, repeat=2)))
def test_solids_overlap_unless_a_plane_separates_them(first: str, second: str) -> None:
    rng = np.random.default_rng(0)
    reach, seen = {"small": 0.35, "large": 0.7}, set()
    for _ in range(60):
        sizes = [str(size) for size in rng.choice(["small", "large"], 2)]
        away, turn = (reach[sizes[0]] + reach[sizes[1]]) * rng.uniform(0.6, 1.05), rng.uniform(0, 2 * np.pi)
        one = standing(first, sizes[0], 0, 0, rng.uniform(0, 360))
        other = standing(second, sizes[1], away * np.cos(turn), away * np.sin(turn), rng.uniform(0, 360))
        found = gap(one, other)
        if abs(found) > 0.015:  # half a degree, at the distance of a corner
            assert overlap(one, other) == overlap(other, one) == (found < 0), (one, other, found)
            seen.add(found < 0)
    assert seen == {True, False}


def test_generated_scenes_pass() -> None:
    for k in range(30):
        scene = generate(2, k)
        check(placed_in(scene), scene.rig)


@pytest.mark.parametrize(
    ("move", "said"),
    [
        ((0.0, 0.0, 0.02), "floats above the plane by 0.02"),
        ((0.0, 0.0, -0.3), "sinks into the plane by 0.3"),
        ((9.0, 0.0, 0.0), "not inside the frame"),
        ((-1.9, 0.0, 0.0), "overlaps object 0"),
    ],
)
def test_a_misplaced_object_is_refused(move: tuple[float, float, float], said: str) -> None:
    first, second = standing("cube", "large", -1, 0, 30), standing("sphere", "large", 1, 0)
    check([first, second], Rig())
    x, y, z = (a + b for a, b in zip(second.centre, move, strict=True))
    with pytest.raises(InvalidRequest, match=said) as caught:
        check([first, replace(second, centre=(x, y, z))], Rig())
    assert caught.value.field == "objects.1"


def test_an_object_above_another_does_not_overlap_it() -> None:
    for one, other in product(SHAPES, repeat=2):
        below = standing(one, "small", 0, 0, 20)
        above = replace(standing(other, "small", 0, 0), centre=(0, 0, 0.71 + half_height(other, "small")))
        assert not overlap(below, above)
        assert overlap(below, replace(above, centre=(0, 0, half_height(one, "small") + 0.1)))
