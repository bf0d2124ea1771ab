"""Specs that name meshes by their paths on this machine."""

import json
from pathlib import Path
from typing import Any

import pytest
from torch import nn
from typer.testing import CliRunner

import scene_attack as sa
from scene_attack import Client
from scene_attack.cli import specs
from scene_attack.cli.app import app
from scene_attack.cli.console import remark
from scene_attack.cli.specs import folder_of, read_campaign, read_job, to_library
from scene_attack.client.meshes import Adding, bundle_at, with_meshes_added
from scene_attack.errors import InvalidFields, InvalidRequest
from scene_attack.scenes.library import Library
from scene_attack_service.settings import DEFAULTS, Settings
from tests.unit.client.scripted_service import CAMPAIGN, UPLOADED, Script, client, says, script
from tests.unit.client.scripted_service import job as answered
from tests.unit.scenes.scene_files import Room
from tests.unit.scenes.test_companion_files import MTL, OBJ, image

pytestmark = pytest.mark.slow

__all__ = ["client", "script"]  # fixtures
MISSING = says(404, {"detail": "there is no such upload"}, "application/problem+json")
NAME = "sha256:" + "a" * 64


@pytest.fixture
def library(tmp_path: Path) -> Library:
    return Library(tmp_path / "cache", tmp_path / "data")


def into(library: Library) -> Adding:
    def add(path: Any) -> tuple[str, tuple[str, ...]]:
        entry = library.add(bundle_at(path, DEFAULTS))
        return entry.name, tuple(entry.notes)

    return add


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a mesh and its material; uploads of this machine are beside it."""
    (tmp_path / "chair.obj").write_bytes(OBJ)
    (tmp_path / "my chair.mtl").write_bytes(MTL)
    monkeypatch.setenv("SCENE_ATTACK_DATA", str(tmp_path / "data"))
    return tmp_path


def written(folder: Path, data: dict[str, Any]) -> str:
    (folder / "spec.json").write_text(json.dumps(data), "utf-8")
    return str(folder / "spec.json")


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
    found, _ = with_meshes_added(given, tmp_path / "specs", into(library), remark)
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
    assert with_meshes_added(given, tmp_path / "specs", into(library), remark) == (found, {})


def test_paths_of_standard_input_are_relative_to_the_working_directory(
    tmp_path: Path, library: Library, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "chair.obj").write_bytes(OBJ)
    monkeypatch.chdir(tmp_path)
    found, _ = with_meshes_added(request_with("./chair.obj"), folder_of("-"), into(library), remark)
    assert found["scene"]["objects"][0]["mesh"].startswith("sha256:")


def test_files_that_are_no_meshes_are_refused_with_all_else_that_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: Library
) -> None:
    (tmp_path / "bad.obj").write_bytes(b"hello")
    (tmp_path / "chair.obj").write_bytes(OBJ)
    monkeypatch.setattr(specs, "to_library", lambda _: into(library))
    meshes = ("primitive/cube", "./none.obj", "./bad.obj", "chair.obj")
    spec = written(tmp_path, request_with(*meshes) | {"target": {"name": "nobody"}, "attack": {"steps": -3}})
    with pytest.raises(InvalidFields) as refused:
        read_job(spec, Settings())
    found = {one.field: one.detail for one in refused.value.every}
    assert list(found) == [*(f"scene.objects.{k}.mesh" for k in (1, 2, 3)), "target.name", "attack.steps"]
    assert "there is no file" in found["scene.objects.1.mesh"]
    assert "no vertices" in found["scene.objects.2.mesh"]
    assert found["scene.objects.3.mesh"] == (
        "there is no mesh 'chair.obj'; a file of one's own is written './chair.obj'"
    )


@pytest.mark.parametrize("data", [{}, {"scene": 3}, {"scene": {"objects": "x"}}, {"scene": {"objects": [3, {}]}}])
def test_what_is_no_request_is_left_to_the_parser(library: Library, data: dict[str, Any]) -> None:
    assert with_meshes_added(data, Path(), into(library), remark) == (data, {})


def test_a_campaign_names_a_file_in_every_place_where_it_has_meshes(folder: Path) -> None:
    scene = request_with("./chair.obj")["scene"]
    grids = [{"scenes": {"meshes": ["primitive/cube", "./chair.obj"]}}, {"scenes": [{"ground": None}, scene]}]
    asked: list[Path] = []

    def add(path: Any) -> tuple[str, tuple[str, ...]]:
        asked.append(path)
        return NAME, ()

    found, _ = with_meshes_added({"grids": grids, "jobs": [{"scene": scene}]}, folder, add, remark)
    assert json.dumps(found).count(NAME) == 3
    assert "chair.obj" not in json.dumps(found)
    assert asked == [folder / "chair.obj"], "it is added once"
    (folder / "chair.obj").unlink()
    with pytest.raises(InvalidRequest, match="there is no file") as error:
        read_campaign(written(folder, {"grids": [grid | {"attacks": []} for grid in grids]}), Settings())
    assert "grids.0.scenes.meshes.1" in {one.field for one in error.value.every}


@pytest.mark.parametrize("command", [["submit"], ["campaign", "submit"]], ids=" ".join)
def test_a_mesh_is_uploaded_before_it_is_submitted(
    client: Client, script: Script, folder: Path, command: list[str]
) -> None:
    job = request_with("./chair.obj")
    uploaded = UPLOADED | {"name": NAME, "notes": ["bump map missing"]}
    script.answers = [MISSING, says(201, uploaded), says(202, answered() if command == ["submit"] else CAMPAIGN)]
    spec = written(folder, job if command == ["submit"] else {"jobs": [job]})
    done = CliRunner().invoke(app, [*command, spec, "--url", client.url])
    assert done.exit_code == 0, done.output
    assert f"chair.obj: uploaded as {NAME}" in done.stderr
    assert "./chair.obj: not shown: bump map missing" in done.stderr
    assert [path.partition("?")[0] for _, path, _ in script.seen[1:]] == [
        "/v1/assets",
        f"/v1/{'jobs' if command == ['submit'] else 'campaigns'}",
    ]
    assert b'filename="my chair.mtl"' in script.bodies[1]
    sent = json.loads(script.bodies[2])
    [thing] = (sent if command == ["submit"] else sent["jobs"][0])["scene"]["objects"]
    assert thing == {"mesh": NAME, "scale": 2}


def test_a_mesh_that_the_service_refuses_is_named_with_all_else_that_it_refuses(
    client: Client, script: Script, folder: Path
) -> None:
    named = [{"field": "attack.steps", "detail": "too few"}, {"field": "scene.objects.0.mesh", "detail": "unknown"}]
    script.answers = [
        MISSING,
        says(422, {"detail": "file: no vertices"}, "application/problem+json"),
        says(422, {"detail": "2 fields are wrong", "errors": named}, "application/problem+json"),
    ]
    done = CliRunner().invoke(app, ["submit", written(folder, request_with("./chair.obj")), "--url", client.url])
    assert isinstance(done.exception, InvalidRequest)
    mesh, steps = done.exception.every
    assert (mesh.field, steps.field, steps.detail) == ("scene.objects.0.mesh", "attack.steps", "too few")
    assert "./chair.obj: file: no vertices" in mesh.detail


@pytest.mark.parametrize("command", ["plan", "render"])
def test_a_scene_with_a_file_is_looked_at(folder: Path, command: str) -> None:
    job = request_with("./chair.obj") | {"attack": {"renderer": "pyrender", "queries": 20}}
    job["scene"]["camera"] = {"size": [16, 16]}
    job["scene"].pop("ground")
    done = CliRunner().invoke(app, [command, written(folder, job), "--json"])
    assert done.exit_code == 0, done.output
    assert "./chair.obj: not shown: bump map bumps.png missing" in done.stderr


def test_attack_takes_a_file_of_the_working_directory(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    scene = {"camera": {"size": [16, 16]}, "objects": [{"mesh": "./chair.obj"}]}
    network = nn.Sequential(nn.Flatten(), nn.Linear(3 * 16 * 16, 2))
    target = sa.target(network, preprocessing={"input_size": [16, 16]})
    found = sa.attack(scene, target, {"renderer": "pyrender", "steps": 1, "queries": 4})
    asked: Any = found.record.spec
    assert asked["scene"]["objects"][0]["mesh"] == to_library(Settings())(folder / "chair.obj")[0]


def test_a_scene_by_its_path_is_added_and_followed(folder: Path) -> None:
    (folder / "room.glb").write_bytes(Room().glb)
    source = {"format": "file", "file": "./room.glb", "change": ["Ball"]}
    job = read_job(written(folder, {"scene": {"source": source}}), Settings())
    assert job.scene.objects[0].mesh.endswith("#1")
    assert job.scene.objects[0].mesh.startswith("sha256:")
    with pytest.raises(InvalidFields, match=r"scene\.source\.file: \./none\.glb: there is no file"):
        read_job(written(folder, {"scene": {"source": source | {"file": "./none.glb"}}}), Settings())
