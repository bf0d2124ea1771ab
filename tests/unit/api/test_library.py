import subprocess
import sys

import pytest
from httpx import Client

pytestmark = pytest.mark.slow


def test_scenes_list_meshes_maps_and_whom_to_thank(client: Client) -> None:
    library = client.get("/v1/scenes").json()
    names = {entry["name"] for entry in library["meshes"]}
    assert "primitive/sphere" in names
    assert {entry["name"] for entry in library["environments"]} >= {"uniform"}
    shown = {entry["credit"] for entry in library["meshes"] + library["environments"]} - {None}
    assert set(library["credits"]) == shown


def test_scenes_are_filtered(client: Client) -> None:
    solids = client.get("/v1/scenes", params={"category": "primitive"}).json()["meshes"]
    assert solids
    assert {entry["category"] for entry in solids} == {"primitive"}
    found = client.get("/v1/scenes", params={"category": "primitive", "search": "sphere"}).json()["meshes"]
    assert "primitive/sphere" in {entry["name"] for entry in found}
    assert len(found) < len(solids)
    assert client.get("/v1/scenes", params={"creator": "nobody at all"}).json()["meshes"] == []


def test_targets_are_listed(client: Client) -> None:
    targets = {target["name"]: target for target in client.get("/v1/targets").json()["items"]}
    assert {"efficientnet-lite0", "alexnet", "resnet34"} <= set(targets)
    lite = targets["efficientnet-lite0"]
    assert (lite["classes"], lite["differentiable"]) == (1000, True)


def test_the_api_loads_neither_torch_nor_opengl() -> None:
    code = "import sys, scene_attack_api.main; print([m for m in ('torch', 'OpenGL', 'pyrender') if m in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "[]\n"
