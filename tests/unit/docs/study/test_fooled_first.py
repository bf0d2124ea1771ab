"""The module that was fooled first, read from masks that are made so that it is known."""

from typing import Any

import pytest
import torch

from benchmarks.study.recording import fooled_first
from benchmarks.study.tables import group
from scene_attack_questions.program import FUNCTIONS
from tests.unit.questions.iep.seeded import program

pytestmark = pytest.mark.slow

CELLS = [0, 7, 19]
"""Where the three objects are in masks of 4×5 cells."""
CHAIN = program("scene", "filter_color 0 red", "unique 1", "relate 2 left", "filter_shape 3 cube", "count 4")
SETS = {0: (1, 1, 1), 1: (0, 1, 0), 2: (0, 1, 0), 3: (1, 0, 1), 4: (0, 0, 1)}
"""What each module attends to, of the three objects."""


def masks(**changed: tuple[float, ...]) -> dict[int, torch.Tensor]:
    """The masks; `n4=(…)` are other values of function 4 at the three objects. Other cells have values of their own."""
    found = {}
    for node, values in SETS.items():
        mask = torch.full((4, 5), 0.9)
        mask.view(-1)[CELLS] = torch.tensor(changed.get(f"n{node}", tuple(0.05 + 0.9 * one for one in values)))
        found[node] = mask
    return found


@pytest.mark.parametrize(
    ("changed", "first"),
    [
        ({}, 5),  # no mask changed: the count itself
        ({"n4": (0.05, 0.05, 0.1)}, 4),  # an object left the set
        ({"n4": (0.05, 0.9, 0.95), "n3": (0.95, 0.9, 0.95)}, 3),  # the earlier of two
        ({"n0": (0.95, 0.2, 0.95), "n1": (0.05, 0.2, 0.05)}, 0),  # an object is not seen any more
        ({"n1": (0.05, 0.95, 0.74), "n2": (0.05, 0.95, 0.05)}, 1),  # one joined
        ({"n4": (0.05, 0.05, 0.71)}, 5),  # a member that the mask is less sure of
        ({"n2": (0.99, 0.95, 0.05)}, 2),  # the object that is picked
    ],
)
def test_the_first_function_whose_objects_changed(changed: dict[str, Any], first: int) -> None:
    assert fooled_first(CHAIN, masks(), masks(**changed), CELLS, CELLS) == first


def test_a_mask_that_hovers_at_the_half_is_no_change() -> None:
    before, after = masks(n4=(0.05, 0.05, 0.55)), masks(n4=(0.05, 0.05, 0.35))
    assert fooled_first(CHAIN, before, after, CELLS, CELLS) == 5
    after = masks(n4=(0.05, 0.05, 0.29))
    assert fooled_first(CHAIN, before, after, CELLS, CELLS) == 4


def test_an_object_that_has_moved_is_read_where_it_is() -> None:
    moved = [0, 8, 19]
    after = masks()
    for mask in after.values():
        mask.view(-1)[8], mask.view(-1)[7] = float(mask.view(-1)[7]), 0.9
    assert fooled_first(CHAIN, masks(), after, CELLS, moved) == 5
    assert fooled_first(CHAIN, masks(), after, CELLS, CELLS) != 5


def test_every_function_has_a_group() -> None:
    assert {group(name) for name in FUNCTIONS} == {
        "scene", "filter", "unique", "relate", "same", "or", "and", "count", "exist", "query",
        "compare integers", "compare attributes",
    }  # fmt: skip
    assert group("equal_integer") == group("less_than") == "compare integers"
    assert group("equal_color") == "compare attributes"
