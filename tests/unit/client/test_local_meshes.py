"""Specs that name meshes by their paths on this machine."""

from pathlib import Path
from typing import Any

import pytest

from client.local_meshes import with_meshes_added
from services.errors import InvalidRequest
from services.scenes.library import Library
from tests.unit.scenes.test_beside import MTL, OBJ, image


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path / "cache", tmp_path / "data")


def request_with(*meshes: object) -> dict[str, Any]:
    return {"seed": 3, "scene": {"ground": [0, 0, 0], "objects": [{"mesh": mesh, "scale": 2} for mesh in meshes]}}


def test_paths_are_relative_to_the_spec_and_bring_their_files(
    tmp_path: Path, library: Library, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "models" / "tex").mkdir(parents=True)
    (tmp_path / "specs").mkdir()
    for name, data in {"chair.obj": OBJ, "my chair.mtl": MTL, "tex/wood.png": image()}.items():
        (tmp_path / "models" / name).write_bytes(data)
    given = request_with("../models/chair.obj", "primitive/cube")
    found = with_meshes_added(given, str(tmp_path / "specs" / "job.json"), library.add)
    first, second = found["scene"]["objects"]
    assert given == request_with("../models/chair.obj", "primitive/cube"), "what was given is not changed"
    assert found | {"scene": None} == given | {"scene": None}
    assert (first["scale"], second) == (2, {"mesh": "primitive/cube", "scale": 2})
    entry = library.entry(first["mesh"])
    assert entry is not None
    assert entry.title == "chair"
    assert "texture tex/wood.png" in entry.used
    assert "not shown: bump map bumps.png missing" in capsys.readouterr().err
    assert any(part.textured for part in library.mesh(first["mesh"]).parts)
    assert with_meshes_added(given, str(tmp_path / "specs" / "job.json"), library.add) == found


def test_paths_of_standard_input_are_relative_to_the_working_directory(
    tmp_path: Path, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "chair.obj").write_bytes(OBJ)
    monkeypatch.chdir(tmp_path)
    found = with_meshes_added(request_with("./chair.obj"), "-", library.add)
    assert found["scene"]["objects"][0]["mesh"].startswith("sha256:")


@pytest.mark.parametrize(("name", "said"), [("./none.obj", "there is no file"), ("./bad.obj", "no vertices")])
def test_a_file_that_is_no_mesh_is_refused_with_its_place(
    tmp_path: Path, library: Library, name: str, said: str
) -> None:
    (tmp_path / "bad.obj").write_bytes(b"hello")
    with pytest.raises(InvalidRequest, match=said) as error:
        with_meshes_added(request_with("primitive/cube", name), str(tmp_path / "job.json"), library.add)
    assert error.value.field == "scene.objects.1.mesh"


@pytest.mark.parametrize("data", [{}, {"scene": 3}, {"scene": {"objects": "x"}}, {"scene": {"objects": [3, {}]}}])
def test_what_is_no_request_is_left_to_the_parser(library: Library, data: dict[str, Any]) -> None:
    assert with_meshes_added(data, "-", library.add) == data
