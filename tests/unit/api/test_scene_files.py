"""A scene's file through the API: uploaded once, and named by a job of which it then is a part."""

from typing import Any

from tests.unit.api.guarded import ATTACK, Guarded
from tests.unit.scenes.scene_files import Room


def upload(guarded: Guarded, caller: str) -> str:
    form = {"files": {"file": ("room.glb", Room().glb)}}
    answer = guarded.client.post("/v1/assets", headers=guarded.headers[caller], **form)  # type: ignore[arg-type]
    assert answer.status_code == 201, answer.text
    name: str = answer.json()["name"]
    return name


def request_with(file: str, *change: str) -> dict[str, Any]:
    source = {"format": "file", "file": file, "change": list(change)}
    return {"scene": {"source": source, "camera": {"size": [32, 48]}}, "attack": ATTACK}


def test_a_job_states_all_that_follows_and_holds_the_file(guarded: Guarded) -> None:
    name = upload(guarded, "alice")
    answer = guarded.client.post("/v1/jobs", json=request_with(name, "Ball"), headers=guarded.headers["alice"])
    assert answer.status_code == 202, answer.text
    scene = answer.json()["spec"]["scene"]
    assert [thing["mesh"] for thing in scene["objects"]] == [f"{name}#1"]
    assert [thing["mesh"] for thing in scene["fixed"]] == [f"{name}#!1"]
    assert scene["source"]["scale"] > 0
    assert scene["camera"]["size"] == [32, 48]
    job = answer.json()["id"]
    refused = guarded.client.delete(f"/v1/assets/{name.removeprefix('sha256:')}", headers=guarded.headers["alice"])
    assert refused.status_code == 409
    assert job in refused.json()["detail"]


def test_bad_names_are_refused_with_their_fields(guarded: Guarded) -> None:
    name = upload(guarded, "alice")
    for caller, file, change, field, sentence in (
        ("alice", name, "Bal", "scene.source.change.0", "there is no node 'Bal' in the file; did you mean 'Ball'"),
        ("alice", "sha256:" + "0" * 64, "Ball", "scene.source.file", "there is no mesh"),
        ("bob", name, "Ball", "scene.source.file", "there is no mesh"),
    ):
        headers = guarded.headers[caller]
        answer = guarded.client.post("/v1/jobs", json=request_with(file, change), headers=headers)
        assert answer.status_code == 422
        [error] = answer.json()["errors"]
        assert error["field"] == field
        assert error["detail"].startswith(sentence)
