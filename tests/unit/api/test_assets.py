"""Uploads through the API: from the upload to the deletion, and what stands in its way."""

from typing import Any

from httpx import Response

from services.pipeline.spec import parse
from tests.unit.api.guarded import ATTACK, Guarded
from tests.unit.api.test_owners import UNKNOWN, names

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
    job, _ = guarded.services.repository.create(parse(request_with(name)), 9, None, lambda _: {}, owner="alice")
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


def test_a_file_that_is_no_mesh_takes_no_quota(guarded: Guarded) -> None:
    before = guarded.services.assets.used("alice")
    assert upload(guarded, "alice", b"OFF\nnothing").status_code == 422
    assert guarded.services.assets.used("alice") == before


def test_a_name_that_is_none_is_not_found(guarded: Guarded) -> None:
    for path in ("/v1/assets/x", "/v1/assets/..%2f..%2fjobs.sqlite", f"/v1/assets/{'A' * 64}"):
        for caller in ("alice", "admin"):
            assert guarded.client.delete(path, headers=guarded.headers[caller]).status_code == 404
