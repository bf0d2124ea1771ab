"""The glTF files, read by trimesh and by the specification."""

import base64
import json
from dataclasses import replace
from io import BytesIO
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from scene_attack.errors import InvalidRequest
from scene_attack.export.glb import COAT, GLTF_SMITH, Glb, asset_glb, scene_glb
from scene_attack.export.scene_values import scene_values
from scene_attack.scenes.description import Background, DirectionalLight, Lights, PointLight, SceneObject, SpotLight
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import Mesh
from scene_attack.scenes.resolve import with_surface
from tests.unit.rendering.shapes import mesh, placed, quad, scene

TEXELS = np.random.default_rng(0).integers(0, 256, (4, 6, 4), dtype=np.uint8)
SQUARE = mesh(quad(color=(0.2, 0.4, 0.6, 1), texture=TEXELS | np.uint8(128), uv=[[0, 0], [2, 0], [2, 1], [0, 1]]))


def written(lights: Lights | None = None, *meshes: Mesh, change: dict[str, Any] | None = None, mapped: bool = False):
    meshes = meshes or (SQUARE,)
    described = scene(objects=len(meshes), lights=lights, azimuth=0.7, elevation=0.3)
    resolved = placed(described, *meshes)
    moved = {group: torch.tensor(value) for group, value in (change or {}).items()}
    glb = scene_glb(resolved, scene_values(resolved, moved), mapped, "environment_before.exr")
    return resolved, glb


def head_of(glb: bytes) -> dict[str, Any]:
    length = int.from_bytes(glb[12:16], "little")
    found: dict[str, Any] = json.loads(glb[20 : 20 + length])
    return found


def loaded(glb: bytes, tmp_path) -> trimesh.Scene:
    (tmp_path / "scene.glb").write_bytes(glb)
    return trimesh.load_scene(tmp_path / "scene.glb")


def matrix_of(head: dict[str, Any], name: str) -> np.ndarray:
    (node,) = (node for node in head["nodes"] if node["name"] == name)
    return np.array(node["matrix"]).reshape(4, 4).T


def test_geometry_and_texture_come_back_as_they_were(tmp_path) -> None:
    _, glb = written()
    read = loaded(glb, tmp_path).geometry["object 0 part 0"]
    [part] = SQUARE.parts
    assert np.array_equal(read.vertices, part.vertices)
    assert np.array_equal(read.vertex_normals, part.normals)
    assert np.array_equal(read.faces, part.faces)
    assert np.allclose(read.visual.uv, part.uv, atol=1e-6)
    assert np.array_equal(np.array(read.visual.material.baseColorTexture)[..., :3], TEXELS[..., :3] | 128)


def test_the_pose_after_the_attack_is_the_objects(tmp_path) -> None:
    change = {"translation": [[0.1, -0.2, 0.3]], "rotation": [[0.0, 0.0, pi / 2]], "color": [[-0.5, 0.0, 0.0]]}
    _, glb = written(change=change)
    pose = loaded(glb, tmp_path).graph["object 0 part 0"][0]
    expected = [[0, -1, 0, 0.1], [1, 0, 0, -0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]]
    assert np.allclose(pose, expected, atol=1e-6)
    material = head_of(glb)["materials"][0]
    assert np.allclose(material["pbrMetallicRoughness"]["baseColorFactor"], [0.1, 0.4, 0.6, 1])


def test_the_camera_projects_as_the_scenes() -> None:
    resolved, glb = written(change={"camera": [0.2, -0.1, 0.5, 0.3]})
    head = head_of(glb)
    [lens] = [one["perspective"] for one in head["cameras"]]
    focal, aspect = 1 / np.tan(lens["yfov"] / 2), lens["aspectRatio"]
    near, far = lens["znear"], lens["zfar"]
    glTF = np.zeros((4, 4))  # of the specification, 3.10.3
    glTF[0, 0], glTF[1, 1], glTF[3, 2] = focal / aspect, focal, -1
    glTF[2, 2], glTF[2, 3] = (far + near) / (near - far), 2 * far * near / (near - far)
    assert np.allclose(glTF, resolved.projection)
    camera = matrix_of(head, "camera")
    assert np.linalg.norm(camera[:3, 3]) == pytest.approx(2.3)
    assert np.allclose(-camera[:3, 2] * 2.3, -camera[:3, 3])  # it looks at the origin
    assert camera[1, 0] / camera[1, 1] == pytest.approx(np.tan(0.3))  # rolled to its left


def test_lights_shine_where_and_how_brightly_they_do() -> None:
    lights = Lights(
        points=(PointLight(energy=10, position=(1, 2, 3)),),
        directional=(DirectionalLight(energy=2, direction=(0, -1, 0)),),
        spots=(SpotLight(energy=8, position=(0, 3, 0), direction=(0, -2, -2), inner_angle=0.1, outer_angle=0.4),),
    )
    _, glb = written(lights, change={"illumination": [0.2, 0.1, *[0.0] * 14]})
    head = head_of(glb)
    listed = {one["name"]: one for one in head["extensions"]["KHR_lights_punctual"]["lights"]}
    assert listed["point 0"]["intensity"] == pytest.approx(0.5 * (10 + 3))  # exposure times energy; a unit is 30
    assert listed["directional 0"]["intensity"] == pytest.approx(1)
    assert listed["spot 0"]["spot"] == {"innerConeAngle": 0.1, "outerConeAngle": 0.4}
    assert head["scenes"][0]["extras"]["ambient"] == pytest.approx(0.5 * 0.6)
    assert np.allclose(matrix_of(head, "point 0")[:3, 3], [1, 2, 3])
    assert np.allclose(matrix_of(head, "directional 0")[:3, :3] @ [0, 0, -1], [0, -1, 0])
    assert np.allclose(matrix_of(head, "spot 0")[:3, :3] @ [0, 0, -1], [0, -(0.5**0.5), -(0.5**0.5)])
    for light in listed:
        assert np.linalg.det(matrix_of(head, light)[:3, :3]) == pytest.approx(1)


def test_a_scene_lit_by_a_map_has_no_light_and_says_so() -> None:
    _, glb = written(mapped=True)
    head = head_of(glb)
    assert "extensions" not in head
    assert head["scenes"][0]["extras"]["environment"] == "environment_before.exr"


def test_surfaces_say_which_formula_is_theirs() -> None:
    _, glb = written(None, SQUARE, with_surface(SQUARE, 0.7, 0.2))
    of = {one["name"]: one for one in head_of(glb)["materials"]}
    assert of["object 0 part 0"]["extras"]["brdf"] == COAT
    assert of["object 1 part 0"]["extras"]["brdf"] == GLTF_SMITH
    assert of["object 1 part 0"]["pbrMetallicRoughness"]["metallicFactor"] == 0.7


def test_objects_of_one_mesh_share_its_bytes() -> None:
    one, two = written(None, SQUARE)[1], written(None, SQUARE, SQUARE)[1]
    assert len(head_of(two)["bufferViews"]) == len(head_of(one)["bufferViews"])


def test_an_object_of_the_scene_is_named() -> None:
    _, glb = written()
    (node,) = (node for node in head_of(glb)["nodes"] if node["name"] == "object 0")
    assert node["extras"]["mesh"] == SceneObject(mesh="primitive/sphere").mesh


def test_the_image_behind_the_objects_is_that_of_the_camera() -> None:
    described = scene(azimuth=0.7, elevation=0.3).model_copy(update={"background": Background()})
    light = np.random.default_rng(1).uniform(0.1, 2, (16, 32, 3)).astype(np.float32)
    resolved = replace(placed(described, SQUARE), environment=light)
    found = []
    for change in ({}, {"camera": torch.tensor([0.9, -0.3, 0.5, 0.3])}):
        extras = head_of(scene_glb(resolved, scene_values(resolved, change), False))["scenes"][0]["extras"]
        with Image.open(BytesIO(base64.b64decode(extras["background"]))) as image:
            found.append(np.asarray(image) / 255)
    assert np.array_equal(found[0], resolved.ground)
    assert np.abs(found[1] - found[0]).max() > 0.1
    assert "background" not in head_of(written()[1])["scenes"][0]["extras"]


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


@pytest.mark.parametrize("length", range(1, 5))
def test_chunks_begin_where_glb_says(length: int) -> None:
    """At multiples of four bytes (glTF 2.0, section 4.4), however long the JSON is."""
    glb = Glb({"title": "x" * length}).written()
    size = int.from_bytes(glb[12:16], "little")
    assert (size % 4, 20 + size) == (0, len(glb))
    assert json.loads(glb[20:])["asset"]["extras"] == {"title": "x" * length}
