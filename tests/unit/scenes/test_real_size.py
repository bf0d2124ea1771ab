"""The real length of a scene unit, which the furniture catalogue's sizes give."""

import numpy as np
import pytest

from tests.unit.jobs.small import LIBRARY


@pytest.mark.parametrize("name", ["grand-piano", "soccer-ball", "desk"])
def test_a_mesh_has_its_catalogue_size_in_all_three_directions(name: str) -> None:
    [entry] = [one for one in LIBRARY.entries() if one.name == f"furniture/{name}"]
    assert entry.size is not None
    width, depth, height = entry.size
    mesh = LIBRARY.mesh(entry.name)
    assert mesh.centimetres is not None
    points = np.concatenate([part.vertices[part.faces].reshape(-1, 3) for part in mesh.parts])
    extent = (points.max(axis=0) - points.min(axis=0)) * mesh.centimetres
    assert extent == pytest.approx([width, height, depth], rel=1e-3)


def test_a_primitive_has_no_real_size() -> None:
    assert LIBRARY.mesh("primitive/sphere").centimetres is None
