"""A mesh as arrays: how it is drawn, where it travels, and what is said of arrays that are none."""

import json
import os
import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh

import scene_attack as sa

pytestmark = pytest.mark.slow
CAPSULE = trimesh.creation.capsule(height=1.0, radius=0.4)
MESH = sa.Mesh(CAPSULE.vertices, CAPSULE.faces)
ATTACK = sa.FGSM(renderer="image", base_renderer="pyrender", steps=1)


def scene(mesh: Any) -> sa.Scene:
    return sa.Scene(camera=sa.Camera(size=(32, 32)), objects=[sa.Object(mesh=mesh)])


def target() -> sa.Target:
    module = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(192, 3))
    return sa.target(module, preprocessing={"input_size": [8, 8]})


def test_it_is_drawn_as_its_file_is(tmp_path: Path) -> None:
    CAPSULE.export(tmp_path / "capsule.ply")
    as_file, as_arrays = (sa.renderer(scene(mesh), "pyrender").render({}) for mesh in (tmp_path / "capsule.ply", MESH))
    torch.testing.assert_close(as_arrays, as_file, rtol=0, atol=1e-5)
    assert as_arrays.std() > 0.05


def test_its_name_is_that_of_what_it_is_and_all_that_json_has_of_it() -> None:
    assert sa.Mesh(CAPSULE.vertices.tolist(), CAPSULE.faces.tolist()) == MESH
    assert sa.Mesh(2 * CAPSULE.vertices, CAPSULE.faces) != MESH
    assert scene(MESH).model_dump(mode="json", exclude_unset=True)["objects"] == [{"mesh": str(MESH)}]
    assert deepcopy(scene(MESH)).objects[0].mesh is MESH


def test_a_result_has_it_and_is_replayed_where_nobody_knows_it(tmp_path: Path) -> None:
    result = sa.attack(scene(MESH), "efficientnet-lite0", ATTACK, out=tmp_path / "out")
    spec: Any = result.record.spec
    assert spec["scene"]["objects"][0]["mesh"] == MESH
    result.save(tmp_path / "saved")
    again = "import sys, scene_attack as sa; print(sa.load(sys.argv[1]).replay().reproduced)"
    for folder in ("out", "saved"):
        command = [sys.executable, "-P", "-c", again, str(tmp_path / folder)]
        environment = os.environ | {"SCENE_ATTACK_DATA": str(tmp_path / "elsewhere")}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=300)
        assert (done.stdout, done.stderr) == ("True\n", "")


def test_a_campaign_takes_it_in_both_places(tmp_path: Path) -> None:
    columns = [{"name": "image", "attack": ATTACK}]
    meshes, camera = {"meshes": [MESH], "camera": {"size": [32, 32]}}, sa.Camera(size=(32, 32), azimuth=1.0)
    scenes = [scene(MESH).model_copy(update={"camera": camera})]
    grids = [
        sa.Grid(scenes=one, targets=["module"], attacks=columns, selection={"right": False}) for one in (meshes, scenes)
    ]
    run = sa.campaign(sa.Campaign(grids=grids), tmp_path, targets=[target()])
    named = [json.loads(path.read_text())["spec"]["scene"] for path in tmp_path.glob("jobs/*/result.json")]
    assert [one["objects"][0]["mesh"] for one in named] == [MESH, MESH]
    assert len(run.results) == 2


@pytest.mark.parametrize(
    ("vertices", "faces", "field", "said"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], "vertices", r"numbers \[V, 3\], not float64 \[3, 2\]"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "vertices", "finite"),
        (np.eye(3), [[0, 1, 3]], "faces", "from 0 to 2, not 3"),
        (np.eye(3), [[0, 1, -1]], "faces", "not -1"),
        (np.eye(3), [[0.0, 1.0, 2.0]], "faces", r"not float64 \[1, 3\]"),
        (np.eye(3), np.zeros((0, 3), int), "faces", r"not int64 \[0, 3\]"),
    ],
)
def test_arrays_that_are_no_mesh_are_refused(vertices: Any, faces: Any, field: str, said: str) -> None:
    with pytest.raises(sa.InvalidRequest, match=said) as refused:
        sa.Mesh(vertices, faces)
    assert refused.value.field == field


def test_arrays_without_an_extent_and_a_file_that_is_not_there_are_refused_by_their_field() -> None:
    for mesh, said in (
        (sa.Mesh(np.zeros((3, 3)), [[0, 1, 2]]), "one point|no area"),
        ("./none.obj", "there is no file"),
    ):
        with pytest.raises(sa.InvalidRequest, match=said) as refused:
            sa.renderer(scene(mesh))
        assert refused.value.field == "scene.objects.0.mesh"
