"""The kinds of the library's furniture: what a person would call a model ("chair", "hand tool"), reviewed by hand.

The truth of a scene and the classes of the networks that we train follow from this table. A model whose kind is in
doubt has none. `Entry.category` is the creators' own word, which is a room ("Bedroom") as often as a kind.
"""

import json
from functools import cache
from pathlib import Path

PREFIX = "furniture/"


@cache
def kinds() -> dict[str, tuple[str, ...]]:
    """Returns the names of the meshes of each kind, {kind: ("furniture/<slug>", …)}, in the table's order."""
    table = json.loads(Path(__file__).with_name("furniture_kinds.json").read_text())
    return {kind: tuple(PREFIX + slug for slug in slugs) for kind, slugs in table.items()}


def kind_of(mesh: str) -> str | None:
    """Returns the kind of a mesh by its name ("furniture/couch" → "sofa"), or None where nobody has said it."""
    return _kinds_by_mesh().get(mesh)


@cache
def _kinds_by_mesh() -> dict[str, str]:
    return {mesh: kind for kind, meshes in kinds().items() for mesh in meshes}
