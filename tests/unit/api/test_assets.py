"""Uploads through the API: from the upload to the deletion, and what stands in its way."""

import io
import zipfile
from typing import Any

import numpy as np
import pytest
from httpx import Response
from PIL import Image

from scene_attack.runs.spec import parse
from tests.unit.api.guarded import ATTACK, Guarded
from tests.unit.api.test_owners import UNKNOWN, names
from tests.unit.scenes.test_companion_files import MTL, OBJ, image
from tests.unit.scenes.test_uploaded_maps import TEXELS, exr

PYRAMID = b"OFF\n4 4 0\n0 0 0\n3 0 0\n0 1 0\n0 0 2\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


def upload(guarded: Guarded, caller: str, data: bytes = PYRAMID) -> Response:
    form = {"files": {"file": ("p.off", data)}, "data": {"kind": "off"}}
    return guarded.client.post("/v1/assets", headers=guarded.headers[caller], **form)  # type: ignore[arg-type]


def delete(guarded: Guarded, caller: str, name: str) -> Response:
    path = f"/v1/assets/{name.removeprefix('sha256:')}"
    return guarded.client.delete(path, headers=guarded.headers[caller])


def request_with(mesh: str) -> dict[str, Any]:
    return {"scene": {"camera": {"size": [32, 32]}, "objects": [{"mesh": mesh}]}, "attack": ATTACK}


def test_a_mesh_is_deleted_once_nothing_refers_to_it(guarded: Guarded) -> None:
    before = guarded.services.assets.used("alice")
    name = upload(guarded, "alice").json()["name"]
    job, _ = guarded.services.record.jobs.create(parse(request_with(name)), 9, None, lambda _: {}, owner="alice")
    assert job is not None
    path = f"/v1/jobs/{job.id}"
    for caller in ("alice", "admin"):
        refused = delete(guarded, caller, name)
        assert refused.status_code == 409, refused.text
        assert job.id in refused.json()["detail"]
    assert delete(guarded, "bob", name).status_code == 404
    guarded.client.post(f"{path}/cancel", headers=guarded.headers["alice"])
    assert guarded.client.delete(path, headers=guarded.headers["alice"]).status_code == 204
    assert delete(guarded, "alice", name).status_code == 204
    assert guarded.services.assets.used("alice") == before
    assert not guarded.services.library.has_upload(name)
    for caller in ("alice", "admin"):
        assert name not in names(guarded, caller, "/v1/assets")
        assert delete(guarded, caller, name).content == delete(guarded, caller, UNKNOWN).content
        assert delete(guarded, caller, name).status_code == 404
    refused = guarded.client.post("/v1/jobs", json=request_with(name), headers=guarded.headers["alice"])
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "scene.objects.0.mesh"
    assert upload(guarded, "alice").json()["name"] == name
    assert delete(guarded, "alice", name).status_code == 204


def test_the_files_stay_for_another_owner(guarded: Guarded) -> None:
    name = upload(guarded, "alice").json()["name"]
    assert upload(guarded, "bob").status_code == 201
    assert delete(guarded, "alice", name).status_code == 204
    assert name not in names(guarded, "alice", "/v1/assets")
    assert name in names(guarded, "bob", "/v1/assets")
    assert delete(guarded, "admin", name).status_code == 204
    assert name not in names(guarded, "bob", "/v1/assets")


def send(guarded: Guarded, files: dict[str, bytes], **data: str) -> Response:
    parts = [("file", (name, one)) for name, one in files.items()]
    return guarded.client.post("/v1/assets", headers=guarded.headers["alice"], files=parts, data=data)


def zipped(files: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return buffer.getvalue()


CHAIR = {"chair/chair.obj": OBJ, "chair/my chair.mtl": MTL, "chair/tex/wood.png": image()}


def test_a_mesh_with_its_files_is_the_same_as_several_files_and_as_a_zip(guarded: Guarded) -> None:
    several = send(guarded, CHAIR)
    assert several.status_code == 201, several.text
    entry = several.json()
    assert entry["used"] == ["material library my chair.mtl", "texture tex/wood.png"]
    assert entry["notes"][:2] == ["bump map bumps.png missing", "texture /home/me/capsule0.jpg missing"]
    assert send(guarded, {"models.zip": zipped(CHAIR | {"readme.txt": b"hello"})}).json() == entry
    moved = {name.removeprefix("chair/"): data for name, data in CHAIR.items()}
    assert send(guarded, moved, kind="obj").json() == entry
    assert send(guarded, {"chair.obj": OBJ}).json()["name"] != entry["name"]
    assert guarded.services.assets.used("alice") >= sum(map(len, CHAIR.values()))


def test_what_is_said_of_a_mesh_is_stored_with_it(guarded: Guarded) -> None:
    said = {"name": "Büro chair", "licence": "CC BY 4.0", "credit": "Chair by Ada, CC BY 4.0", "up": "z"}
    entry = send(guarded, {"p.off": PYRAMID}, **said).json()
    assert (entry["title"], entry["licence"], entry["credit"]) == (said["name"], said["licence"], said["credit"])
    assert entry["name"] != send(guarded, {"p.off": PYRAMID}).json()["name"]
    mesh = guarded.services.library.mesh(entry["name"])
    assert mesh.credit == said["credit"]
    vertices = np.concatenate([part.vertices for part in mesh.parts])
    assert np.argmax(vertices.max(axis=0) - vertices.min(axis=0)) == 0
    assert np.argmin(vertices.max(axis=0) - vertices.min(axis=0)) == 2, "y of the file, its shortest side, is -z"
    listed = guarded.client.get("/v1/scenes", headers=guarded.headers["alice"], params={"search": "büro"}).json()
    assert [one["name"] for one in listed["meshes"]] == [entry["name"]]
    assert said["credit"] in listed["credits"]


@pytest.mark.parametrize(
    ("field", "value"), [("name", "x" * 101), ("credit", "a\x1b[31m"), ("up", "x"), ("licence", "a\nb")]
)
def test_what_cannot_be_said_of_a_mesh_is_refused(guarded: Guarded, field: str, value: str) -> None:
    refused = send(guarded, {"p.off": PYRAMID}, **{field: value})
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == field


def test_of_two_meshes_one_is_chosen(guarded: Guarded) -> None:
    files = {**CHAIR, "p.off": PYRAMID}
    for sent in (files, {"models.zip": zipped(files)}):
        refused = send(guarded, sent)
        assert refused.status_code == 422
        (error,) = refused.json()["errors"]
        assert error["field"] == "mesh"
        assert "'chair/chair.obj', 'p.off'" in error["detail"]
        assert send(guarded, sent, mesh="p.off").json()["triangles"] == 4


@pytest.mark.parametrize(
    ("files", "data", "field", "said"),
    [
        ({"a.zip": zipped({"../p.off": PYRAMID})}, {}, "file", "'../p.off' points outside"),
        ({"a.zip": zipped({"p.off": PYRAMID})}, {"mesh": "q.off"}, "mesh", "'q.off'"),
        ({"a.zip": zipped({"p.txt": PYRAMID})}, {}, "kind", "'p.txt'"),
        ({"a.zip": b"PK\x03\x04"}, {"kind": "obj"}, "file", "damaged"),
        ({"../p.off": PYRAMID, "q.png": b""}, {}, "file", "'../p.off' points outside"),
        ({"a/p.off": PYRAMID, "a//p.off": PYRAMID}, {}, "file", "two files are called 'a/p.off'"),
        ({"chair.obj": OBJ, "my chair.mtl": MTL, "wood.png": b"no"}, {}, "file", "texture wood.png"),
        ({"p": PYRAMID}, {}, "kind", "'p'"),
    ],
)
def test_files_that_make_no_mesh_are_refused_by_name(
    guarded: Guarded, files: dict[str, bytes], data: dict[str, str], field: str, said: str
) -> None:
    refused = send(guarded, files, **data)
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == field
    assert said in refused.json()["errors"][0]["detail"]


def test_more_files_than_a_mesh_may_have_are_refused(guarded: Guarded) -> None:
    refused = send(guarded, {f"{k}.png": b"" for k in range(501)})
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "file"


def test_a_file_that_is_no_mesh_takes_no_quota(guarded: Guarded) -> None:
    before = guarded.services.assets.used("alice")
    assert upload(guarded, "alice", b"OFF\nnothing").status_code == 422
    assert guarded.services.assets.used("alice") == before


def test_a_name_that_is_none_is_not_found(guarded: Guarded) -> None:
    for path in ("/v1/assets/x", "/v1/assets/..%2f..%2fjobs.sqlite", f"/v1/assets/{'A' * 64}"):
        for caller in ("alice", "admin"):
            assert guarded.client.delete(path, headers=guarded.headers[caller]).status_code == 404


def test_an_uploaded_map_lights_a_request_of_its_owner_alone(guarded: Guarded) -> None:
    sent = send(guarded, {"garden.exr": exr(TEXELS)}, name="Garden", credit="Garden by Ada")
    assert sent.status_code == 201, sent.text
    entry = sent.json()
    assert (entry["kind"], entry["title"], entry["used"]) == ("environment", "Garden", ["16×8 texels"])
    listed = guarded.client.get("/v1/scenes", headers=guarded.headers["alice"]).json()
    assert entry["name"] in {one["name"] for one in listed["environments"]}
    assert entry["name"] not in {one["name"] for one in listed["meshes"]}
    body = request_with("primitive/cube")
    body["scene"]["lights"] = {"environment": {"map": entry["name"]}}
    refused = guarded.client.post("/v1/jobs", json=body, headers=guarded.headers["bob"])
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["field"] == "scene.lights.environment.map"
    job, _ = guarded.services.record.jobs.create(parse(body), 9, None, lambda _: {}, owner="alice")
    assert job is not None
    held = delete(guarded, "alice", entry["name"])
    assert held.status_code == 409, held.text
    path = f"/v1/jobs/{job.id}"
    guarded.client.post(f"{path}/cancel", headers=guarded.headers["alice"])
    guarded.client.delete(path, headers=guarded.headers["alice"])
    assert delete(guarded, "alice", entry["name"]).status_code == 204


def test_an_upload_is_read_by_its_owner_alone_and_a_map_is_seen(guarded: Guarded) -> None:
    entry = send(guarded, {"sky.exr": exr(np.ones((8, 16, 3), np.float32) * (1, 0, 0))}).json()
    path = f"/v1/assets/{entry['name'].removeprefix('sha256:')}"
    assert guarded.client.get(path, headers=guarded.headers["alice"]).json() == entry
    for end in ("", "/thumbnail"):
        assert guarded.client.get(path + end, headers=guarded.headers["bob"]).status_code == 404
    for _ in range(2):
        seen = guarded.client.get(f"{path}/thumbnail", headers=guarded.headers["alice"])
        assert seen.headers["content-type"] == "image/png"
        pixels = np.asarray(Image.open(io.BytesIO(seen.content)))
        assert pixels.shape == (96, 192, 3)
        assert (pixels[..., 0] > 150).all()
        assert (pixels[..., 1:] == 0).all()
    assert entry["thumbnail"] == f"{path}/thumbnail"
    assert delete(guarded, "alice", entry["name"]).status_code == 204
    assert guarded.services.library.thumbnail(entry["name"]) is None
