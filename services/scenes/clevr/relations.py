"""The spatial relations of CLEVR: left, right, front and behind, as the camera sees them on the plane."""

from collections.abc import Mapping, Sequence
from math import hypot
from typing import Literal

from services.scenes.clevr.rig import Rig, Vector

Relation = Literal["left", "right", "front", "behind"]
RELATIONS: tuple[Relation, ...] = ("left", "right", "front", "behind")
MIN_OFFSET = 0.2
"""Two objects whose centres are no further apart along a direction have no relation in it."""


def directions(rig: Rig) -> dict[str, Vector]:
    """Returns the unit vector of each relation in the plane, and CLEVR's `above` and `below`."""
    x, y, _ = rig.camera
    length = hypot(x, y)
    behind = (-x / length, -y / length)
    return {
        "right": (behind[1], -behind[0], 0.0),
        "behind": (behind[0], behind[1], 0.0),
        "above": (0.0, 0.0, 1.0),
        "below": (0.0, 0.0, -1.0),
        "left": (-behind[1], behind[0], 0.0),
        "front": (-behind[0], -behind[1], 0.0),
    }


def relationships(
    positions: Sequence[Sequence[float]], along: Mapping[str, Sequence[float]]
) -> dict[str, list[list[int]]]:
    """Returns for each relation and each object the ascending indices of the objects that have it to that object.

    `relationships(…)["left"][i]` are the objects left of object i. `positions` are the objects' centres [n][3], `along`
    has the unit vector of each relation.
    """
    found: dict[str, list[list[int]]] = {}
    for name in RELATIONS:
        offsets = [sum(a * b for a, b in zip(position, along[name], strict=True)) for position in positions]
        found[name] = [
            [j for j, there in enumerate(offsets) if j != i and there - here > MIN_OFFSET]
            for i, here in enumerate(offsets)
        ]
    return found
