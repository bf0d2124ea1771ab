"""The table of kinds names models that the library has, and each of them once."""

from collections import Counter

from services.scenes.furniture import kind_of, kinds
from services.scenes.library import Library


def test_every_model_of_the_table_is_in_the_library(library: Library) -> None:
    there = {entry.name for entry in library.entries()}
    missing = [mesh for meshes in kinds().values() for mesh in meshes if mesh not in there]
    assert missing == []


def test_a_model_has_one_kind() -> None:
    counts = Counter(mesh for meshes in kinds().values() for mesh in meshes)
    assert [mesh for mesh, count in counts.items() if count > 1] == []


def test_kind_of_a_mesh() -> None:
    assert kind_of("furniture/couch") == "sofa"
    assert kind_of("primitive/cube") is None
    assert kind_of("couch") is None, "a mesh is named with its folder"
