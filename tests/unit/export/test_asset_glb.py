"""The glTF file of one mesh."""

from pathlib import Path

import pytest

from services.errors import InvalidRequest
from services.export.glb import asset_glb
from services.scenes.library import Library
from tests.unit.export.test_scene_glb import head_of, loaded


def test_it_has_the_mesh_alone_and_a_camera(tmp_path: Path) -> None:
    glb = asset_glb("primitive/sphere", Library(tmp_path, tmp_path))
    (mesh,) = loaded(glb, tmp_path).geometry.values()
    assert len(mesh.faces) > 100
    head = head_of(glb)
    assert len(head["cameras"]) == 1
    assert head["scenes"][0]["extras"]["ambient"] > 0


def test_an_unknown_mesh_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="nothing"):
        asset_glb("primitive/nothing", Library(tmp_path, tmp_path))
