"""The modules of the engine, by kind.

A module is a function with its value, named as a program's node is: `filter_color[red]` and `filter_color[blue]` have
weights of their own. `scene` is found once for an image, and `unique` passes its input on; neither has a module here.
"""

from services.questions.functions import FUNCTIONS

MAPPED = ("set", "object")
"""Types of results that are a map, a mask over the image. All others are a vector, with scores over the answers."""


def _modules(n_inputs: int, takes_maps: bool, gives_map: bool) -> tuple[str, ...]:
    return tuple(
        f"{name}[{value}]" if value else name
        for name, function in FUNCTIONS.items()
        if name != "unique"
        and len(function.inputs) == n_inputs
        and all((kind in MAPPED) == takes_maps for kind in function.inputs)
        and (function.output in MAPPED) == gives_map
        for value in function.values or ("",)
    )


MAPPING = _modules(1, takes_maps=True, gives_map=True)
"""From a map to a map: `filter_*`, `relate`, `same_*`."""
JOINING = _modules(2, takes_maps=True, gives_map=True)
"""From two maps to a map: `union`, `intersect`."""
READING = _modules(1, takes_maps=True, gives_map=False)
"""From a map to a vector: `count`, `exist`, `query_*`."""
COMPARING = _modules(2, takes_maps=False, gives_map=False)
"""From two vectors to a vector: `equal_*`, `less_than`, `greater_than`."""

KINDS = {"mapping": MAPPING, "joining": JOINING, "reading": READING, "comparing": COMPARING}
PLACES = {name: (kind, place) for kind, names in KINDS.items() for place, name in enumerate(names)}
"""The kind of each module, and its place in the list of its kind."""
