"""The module of a question's network that an attack fooled first, read from what the modules attend to.

A module's result is read as objects. An object is in a set if the mask at the cell of its centre is at least HALF; it
has left or joined the set if the mask passed HALF and changed by more than LEAST, so that a mask that hovers there is
no change. The module `unique` picks the object with the largest mask. The first module whose objects changed is the one
that was fooled first: those before it see what they saw.

Counts, queries and comparisons attend to nothing. If no set and no object changed, the end of the program was fooled,
its last function, with the counts or queries that a comparison takes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from services.questions.program import Program

HALF = 0.5
"""Between 1, for which masks are trained at the cell of a member's centre, and 0 at other cells."""
LEAST = 0.25
"""Half of the way from HALF to either end."""


def fooled_first(
    program: Program,
    before: Mapping[int, Tensor],
    after: Mapping[int, Tensor],
    cells_before: Sequence[int],
    cells_after: Sequence[int],
) -> int:
    """Returns the number of the function that was fooled first; the last one if no mask says otherwise.

    before and after: what functions attend to, by number, masks [h, w] in [0,1]. cells: the number of each object's
    cell, row by row, before and after the attack, which may have moved it.
    """
    for number in sorted(before):
        old = before[number].flatten()[list(cells_before)]
        new = after[number].flatten()[list(cells_after)]
        if program.types[number] == "object":
            changed = bool(old.argmax() != new.argmax())
        else:
            changed = bool((((old >= HALF) != (new >= HALF)) & ((new - old).abs() > LEAST)).any())
        if changed:
            return number
    return len(program.nodes) - 1


GROUPS = {
    "scene": "scene",
    "filter": "filter",
    "unique": "unique",
    "relate": "relate",
    "same": "same",
    "union": "or",
    "intersect": "and",
    "count": "count",
    "exist": "exist",
    "query": "query",
    "equal_integer": "compare integers",
    "less": "compare integers",
    "greater": "compare integers",
    "equal": "compare attributes",
}
"""Names of the groups of functions, in the order of a program, by how the functions' names begin."""


def group(function: str) -> str:
    """Returns the group of a function, such as "filter" of "filter_color"."""
    return GROUPS.get(function) or GROUPS[function.partition("_")[0]]
