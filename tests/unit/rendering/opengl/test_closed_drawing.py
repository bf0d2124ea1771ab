"""The drawing that is kept from job to job: the same meshes give the same one, others their own."""

from pathlib import Path

import pytest

from scene_attack.rendering.opengl import context
from scene_attack.scenes.library import Library


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path, tmp_path)


def test_the_same_meshes_are_prepared_once_and_other_meshes_never_take_their_place(library: Library) -> None:
    context.current()
    from scene_attack.rendering.opengl.mesh_upload import closed_drawing

    sphere, cube = library.mesh("primitive/sphere"), library.mesh("primitive/cube")
    first = closed_drawing((sphere, cube))
    assert closed_drawing((sphere, cube)) is first
    other = closed_drawing((cube, sphere))
    assert [piece.part for piece in other.pieces] == [*cube.parts, *sphere.parts]
    again = closed_drawing((sphere, cube))
    assert [piece.part for piece in again.pieces] == [*sphere.parts, *cube.parts]
