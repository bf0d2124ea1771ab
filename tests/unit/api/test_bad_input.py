"""Every line of "Bad input": 422 naming the field, and nothing queued."""

import io
import math
from typing import Any

import numpy as np
import pytest
import trimesh
from httpx import Client

from scene_attack_api.requests import Services
from tests.unit.api.conftest import SPHERE
from tests.unit.jobs.records import attacks

pytestmark = pytest.mark.slow


def count(services: Services) -> int:
    return len(attacks(services.record))


def refused(client: Client, services: Services, body: str) -> list[dict[str, str]]:
    before = count(services)
    answer = client.post("/v1/jobs", content=body, headers={"content-type": "application/json"})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == 422
    assert count(services) == before
    errors: list[dict[str, str]] = problem["errors"]
    return errors


def spec(**changes: Any) -> str:
    """SPHERE with values put at dotted paths, as a client's JSON library would write it (NaN and Infinity too)."""
    import copy
    import json

    data = copy.deepcopy(SPHERE)
    for path, value in changes.items():
        at: Any = data
        *parents, last = path.split("__")
        for part in parents:
            at = at[int(part)] if part.isdigit() else at.setdefault(part, {})
        at[int(last) if last.isdigit() else last] = value
    return json.dumps(data)


FGSM = {"renderer": "image", "method": "fgsm"}

BAD = {
    "unknown mesh": ({"scene__objects__0__mesh": "furniture/grand-pino"}, "scene.objects.0.mesh"),
    "unknown primitive": ({"scene__objects__0__mesh": "primitive/dodo"}, "scene.objects.0.mesh"),
    "unknown upload": ({"scene__objects__0__mesh": "sha256:" + "0" * 64}, "scene.objects.0.mesh"),
    "a path as a mesh": ({"scene__objects__0__mesh": "../../etc/passwd"}, "scene.objects.0.mesh"),
    "unknown map": ({"scene__lights__environment__map": "nowhere"}, "scene.lights.environment.map"),
    "unknown target": ({"target__name": "alexnet-9000"}, "target.name"),
    "unknown group": ({"attack__groups": ["gravity"]}, "attack.groups"),
    "group of another renderer": ({"attack__groups": ["normals"]}, "attack.groups"),
    "unknown preset": ({"scene__objects__0__material": "velvet"}, "scene.objects.0.material"),
    "unknown settings preset": ({"attack__preset": "fastest"}, "attack.preset"),
    "unknown renderer": ({"attack__renderer": "povray"}, "attack.renderer"),
    "unknown method": ({"attack__method": "pgd"}, "attack.method"),
    "unknown field": ({"scene__fog": 1}, "scene.fog"),
    "image too large": ({"scene__camera__size": [32, 4096]}, "scene.camera.size.1"),
    "image empty": ({"scene__camera__size": [0, 32]}, "scene.camera.size.0"),
    "no objects": ({"scene__objects": []}, "scene.objects"),
    "too many objects": ({"scene__objects": [{"mesh": "primitive/sphere"}] * 17}, "scene.objects"),
    "too many lights": ({"scene__lights": {"points": [{}] * 5}}, "scene.lights.points"),
    "too many suns": ({"scene__lights": {"directional": [{}] * 5}}, "scene.lights.directional"),
    "too many spots": ({"scene__lights": {"spots": [{}] * 5}}, "scene.lights.spots"),
    "no direction": (
        {"scene__lights": {"directional": [{"direction": [0, 0, 0]}]}},
        "scene.lights.directional.0.direction",
    ),
    "cone inside out": (
        {"scene__lights": {"spots": [{"inner_angle": 0.5, "outer_angle": 0.5}]}},
        "scene.lights.spots.0.outer_angle",
    ),
    "cone without an outside, by its default": (
        {"scene__lights": {"spots": [{"inner_angle": 1.0}]}},
        "scene.lights.spots.0.outer_angle",
    ),
    "cone too wide": ({"scene__lights": {"spots": [{"outer_angle": 2}]}}, "scene.lights.spots.0.outer_angle"),
    "steps out of bounds": ({"attack__steps": 0}, "attack.steps"),
    "queries out of bounds": ({"attack__queries": 10**9}, "attack.queries"),
    "seconds out of bounds": ({"attack__seconds": -1}, "attack.seconds"),
    "coordinates out of bounds": ({"attack__coordinates": 0}, "attack.coordinates"),
    "truncation out of bounds": ({"attack": FGSM | {"truncation": 256}}, "attack.truncation"),
    "seed out of bounds": ({"seed": -1}, "seed"),
    "angle not a number": ({"scene__camera__azimuth": math.nan}, "scene.camera.azimuth"),
    "light infinite": ({"scene__lights": {"points": [{"energy": math.inf}]}}, "scene.lights.points.0.energy"),
    "colour minus infinite": ({"scene__objects__0__color": [-math.inf, 0, 0]}, "scene.objects.0.color.0"),
    "ground not a number": ({"scene__ground": [math.nan] * 3}, "scene.ground.0"),
    "weight infinite": ({"attack__weight": math.inf}, "attack.weight"),
    "momentum not a number": ({"attack": FGSM | {"momentum": math.nan}}, "attack.momentum"),
    "rate not a number": ({"attack": FGSM | {"learning_rate": {"image": math.nan}}}, "attack.learning_rate.image"),
    "steps not a number": ({"attack__steps": math.nan}, "attack.steps"),
    "label out of range": ({"goal": {"leave": 1000}}, "goal.leave"),
    "a truth that is no label": ({"goal": {"truth": "grand pino"}}, "goal.truth"),
    "a truth that is no label, among others": ({"goal": {"truth": ["tench", "grand pino"]}}, "goal.truth.1"),
    "no label to leave": ({"goal": {"leave": []}}, "goal.leave"),
    "least confidence out of bounds": ({"goal": {"least_confidence": 1.0}}, "goal.least_confidence"),
    "unknown label": ({"goal": {"reach": "grand pino"}}, "goal.reach"),
    "a network that is already wrong": ({"goal": {"leave": "tench"}}, "goal.leave"),
    "object out of view": ({"scene__objects__0__translation": [50, 0, 0]}, "scene.objects.0"),
    "object behind the camera": ({"scene__objects__0__translation": [0, 0, 60]}, "scene.objects.0"),
    "a question to a classifier": ({"target__ask": {"question": "What colour is it?"}}, "target.ask"),
}


@pytest.mark.parametrize(("changes", "field"), BAD.values(), ids=BAD.keys())
def test_a_bad_spec_is_refused_by_name(client: Client, services: Services, changes: dict[str, Any], field: str) -> None:
    errors = refused(client, services, spec(**changes))
    assert [error["field"] for error in errors][:1] == [field]
    assert all(error["detail"] for error in errors)


def test_a_close_name_is_suggested(client: Client, services: Services) -> None:
    (error,) = refused(client, services, spec(scene__objects__0__mesh="primitive/spere"))
    assert "primitive/sphere" in error["detail"]


def test_without_a_label_the_first_answer_is_the_one_to_leave(client: Client) -> None:
    made = client.post("/v1/jobs", json=SPHERE)
    assert made.status_code == 202, made.text
    assert isinstance(made.json()["spec"]["goal"]["leave"], str)


def test_an_accepted_job_carries_its_warnings(client: Client) -> None:
    (unknown, *_) = client.post("/v1/jobs", json=SPHERE).json()["warnings"]
    assert (unknown["code"], unknown["field"]) == ("truth-unknown", "goal.truth")
    made = client.post("/v1/jobs", json=SPHERE | {"goal": {"truth": ["tench", "goldfish"]}})
    assert made.status_code == 202, made.text
    wrong = made.json()["warnings"][0]
    assert (wrong["code"], wrong["field"]) == ("already-wrong", "goal.truth")
    assert "not 'tench' or 'goldfish'" in wrong["text"]
    assert client.get(f"/v1/jobs/{made.json()['id']}").json()["warnings"] == made.json()["warnings"]


def stl(**changes: Any) -> bytes:
    mesh = trimesh.creation.icosphere(subdivisions=1, **changes)
    data = mesh.export(file_type="stl")
    assert isinstance(data, bytes)
    return data


def obj(vertices: str, faces: str = "f 1 2 3\n") -> bytes:
    return ("".join(f"v {v}\n" for v in vertices.split("|")) + faces).encode()


def not_finite() -> bytes:
    data = bytearray(stl())
    data[96:100] = np.float32(np.nan).tobytes()  # a coordinate of the first triangle
    return bytes(data)


MESHES = {
    "not what it says": (b"solid nonsense, really\x00\xff" * 9, "glb", "file"),
    "an image": (b"\x89PNG\r\n\x1a\n" + bytes(500), "ply", "file"),
    "too large": (bytes(300_001), "stl", "file"),
    "much too large": (bytes(900_000), "stl", "file"),
    "too many triangles": (trimesh.creation.icosphere(subdivisions=4).export(file_type="stl"), "stl", "file"),
    "empty": (b"", "obj", "file"),
    "no triangles": (obj("0 0 0|1 0 0|0 1 0", ""), "obj", "file"),
    "no area": (obj("0 0 0|1 0 0|2 0 0"), "obj", "file"),
    "vertices not finite": (not_finite(), "stl", "file"),
    "vertices not finite in text": (obj("nan 0 0|1 0 0|0 1 0"), "obj", "file"),
    "a kind that is not read": (stl(), "fbx", "kind"),
    "a pickle": (b"\x80\x04\x95", "pkl", "kind"),
}


@pytest.mark.parametrize(("data", "kind", "field"), MESHES.values(), ids=MESHES.keys())
def test_a_bad_mesh_is_refused_by_name(client: Client, data: bytes, kind: str, field: str) -> None:
    before = client.get("/v1/assets").json()
    answer = client.post("/v1/assets", files={"file": ("mesh", io.BytesIO(data))}, data={"kind": kind})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert [error["field"] for error in answer.json()["errors"]] == [field]
    assert client.get("/v1/assets").json() == before


@pytest.mark.parametrize(("parts", "field"), [({"data": {"kind": "stl"}}, "file"), ({}, "kind")])
def test_a_part_that_is_missing_is_named(client: Client, parts: dict[str, Any], field: str) -> None:
    if field == "kind":
        answer = client.post("/v1/assets", files={"file": stl()})
    else:
        answer = client.post("/v1/assets", files={"other": b""}, **parts)
    assert answer.status_code == 422
    assert [error["field"] for error in answer.json()["errors"]] == [field]


def test_a_body_without_a_length_is_stopped_when_it_is_too_large(client: Client) -> None:
    head = b'--b\r\ncontent-disposition: form-data; name="file"; filename="m"\r\n\r\n'
    sent = []

    def chunks():  # type: ignore[no-untyped-def]
        yield head
        for n in range(100):
            sent.append(n)
            yield bytes(100_000)

    answer = client.post("/v1/assets", content=chunks(), headers={"content-type": "multipart/form-data; boundary=b"})
    assert answer.status_code == 422, answer.text
    assert [error["field"] for error in answer.json()["errors"]] == ["file"]


def test_a_good_mesh_is_kept_listed_and_can_be_attacked(client: Client) -> None:
    data = stl()
    made = client.post("/v1/assets", files={"file": data}, data={"kind": "stl"})
    assert made.status_code == 201, made.text
    entry = made.json()
    assert entry["triangles"] == 80
    assert entry in client.get("/v1/assets").json()["items"]
    again = client.post("/v1/assets", files={"file": data}, data={"kind": "stl"})
    assert again.json() == entry
    body = SPHERE | {"scene": SPHERE["scene"] | {"objects": [{"mesh": entry["name"]}]}}
    assert client.post("/v1/jobs", json=body).status_code == 202


@pytest.mark.parametrize(
    ("query", "field", "said"),
    [
        ("limit=500", "limit", 'must be at most 200, not "500"'),
        ("limit=many", "limit", 'must be an integer, not "many"'),
        ("state=runing", "state", "; did you mean 'running'"),
    ],
)
def test_a_wrong_query_parameter_is_said_in_words(client: Client, query: str, field: str, said: str) -> None:
    answer = client.get(f"/v1/jobs?{query}")
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["field"] == field
    assert said in error["detail"]
    assert "Input" not in error["detail"]


def test_all_wrong_query_parameters_are_named(client: Client) -> None:
    answer = client.get("/v1/jobs?limit=0&state=gone")
    assert {error["field"] for error in answer.json()["errors"]} == {"limit", "state"}
