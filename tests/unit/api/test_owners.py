"""What an owner has does not exist for another one, by whatever route or name it is asked for."""

import pytest
from httpx import Response

from tests.unit.api.guarded import ATTACK, CAMPAIGN, OWNED, SPHERE, Guarded

pytestmark = pytest.mark.slow

TETRAHEDRON = b"OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
UNKNOWN = "sha256:" + "0" * 64


@pytest.fixture(scope="module")
def mesh(guarded: Guarded) -> str:
    """The name of a mesh that alice has uploaded."""
    answer = upload(guarded, "alice")
    assert answer.status_code == 201, answer.text
    return str(answer.json()["name"])


def upload(guarded: Guarded, caller: str) -> Response:
    form = {"files": {"file": ("t.off", TETRAHEDRON)}, "data": {"kind": "off"}}
    return guarded.client.post("/v1/assets", headers=guarded.headers[caller], **form)  # type: ignore[arg-type]


def names(guarded: Guarded, caller: str, path: str) -> set[str]:
    found = guarded.client.get(path, headers=guarded.headers[caller]).json()
    return {item.get("id") or item["name"] for item in found.get("items", found.get("meshes"))}


@pytest.mark.parametrize("route", OWNED)
def test_what_another_owner_has_is_not_found_like_what_nobody_has(guarded: Guarded, route: str) -> None:
    answer = guarded.ask(route, "bob")
    assert answer.status_code == 404, answer.text
    nothing = guarded.ask(route, "bob", exists=False)
    assert answer.content == nothing.content
    unlike = {"date", "x-request-id"}
    assert {k: v for k, v in answer.headers.items() if k not in unlike} == {
        k: v for k, v in nothing.headers.items() if k not in unlike
    }
    assert guarded.untouched()


@pytest.mark.parametrize("route", [one for one in OWNED if one.startswith("GET") and not one.endswith(("events", "}"))])
def test_the_owner_and_an_administrator_find_it(guarded: Guarded, route: str) -> None:
    found = 409 if route.endswith(("/export", "/scene.glb")) else 200  # the job has no result to export yet
    assert guarded.ask(route, "alice").status_code == guarded.ask(route, "admin").status_code == found


@pytest.mark.parametrize(("path", "what"), [("/v1/jobs", "job"), ("/v1/campaigns", "campaign")])
def test_lists_have_the_callers_own(guarded: Guarded, path: str, what: str) -> None:
    alices = getattr(guarded, what)
    assert alices in names(guarded, "alice", path)
    assert alices in names(guarded, "admin", path)
    assert alices not in names(guarded, "bob", path)
    page = path.removeprefix("/v1") if what == "campaign" else "/"
    assert alices in guarded.client.get(page, headers=guarded.headers["alice"]).text
    assert alices not in guarded.client.get(page, headers=guarded.headers["bob"]).text


def test_jobs_of_another_owners_campaign_are_not_listed(guarded: Guarded) -> None:
    query = {"campaign": guarded.campaign}
    assert guarded.client.get("/v1/jobs", params=query, headers=guarded.headers["bob"]).json()["items"] == []


def test_an_uploaded_mesh_is_listed_for_those_who_uploaded_it(guarded: Guarded, mesh: str) -> None:
    for path in ("/v1/assets", "/v1/scenes?search=uploaded"):
        assert [mesh in names(guarded, caller, path) for caller in ("alice", "admin", "bob")] == [True, True, False]


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/v1/jobs", {"scene": {**SPHERE, "objects": [{"mesh": "…"}]}, "attack": ATTACK}),
        ("/v1/campaigns", {"jobs": [{"scene": {**SPHERE, "objects": [{"mesh": "…"}]}, "attack": ATTACK}]}),
        ("/v1/campaigns", {"grids": [{**CAMPAIGN["grids"][0], "scenes": {"meshes": ["…"]}}]}),
        ("/v1/rerenderings", {"image": {"data": ""}, "scene": {"objects": [{"mesh": "…"}]}}),
    ],
)
def test_another_owners_mesh_is_unknown_in_a_request(guarded: Guarded, mesh: str, path: str, body: object) -> None:
    def send(name: str) -> Response:
        return guarded.client.post(path, json=named(body, name), headers=guarded.headers["bob"])

    answer, unknown = send(mesh), send(UNKNOWN)
    assert answer.status_code == unknown.status_code == 422
    assert answer.text.replace(mesh, UNKNOWN) == unknown.text
    assert "there is no mesh" in answer.text
    assert mesh not in send(mesh[:-2] + "zz").text  # nor is it suggested


def named(body: object, name: str) -> object:
    """The body with the name in place of each `…`."""
    if isinstance(body, dict):
        return {key: named(value, name) for key, value in body.items()}
    return [named(one, name) for one in body] if isinstance(body, list) else name if body == "…" else body


def test_a_file_of_another_owners_job_is_unknown_to_the_defence(guarded: Guarded) -> None:
    def send(job: str) -> Response:
        return guarded.client.post("/v1/rerenderings", json={"image": {"job": job}}, headers=guarded.headers["bob"])

    assert send(guarded.job).content == send("none").content
    assert send("none").status_code == 422


def test_who_uploads_the_same_mesh_sees_it_too(guarded: Guarded, mesh: str) -> None:
    assert upload(guarded, "bob").json()["name"] == mesh
    assert mesh in names(guarded, "bob", "/v1/assets")
    before = guarded.services.assets.used("bob")
    assert before >= len(TETRAHEDRON)
    assert upload(guarded, "bob").status_code == 201
    assert guarded.services.assets.used("bob") == before


def test_idempotency_keys_are_each_owners_own(guarded: Guarded) -> None:
    for path, body in (("/v1/campaigns", CAMPAIGN), ("/v1/campaigns", {**CAMPAIGN, "name": "another"})):
        headers = {"Idempotency-Key": "k" * 255}
        owner = "alice" if body is CAMPAIGN else "bob"
        first = guarded.client.post(path, json=body, headers=headers | guarded.headers[owner])
        again = guarded.client.post(path, json=body, headers=headers | guarded.headers[owner])
        assert first.status_code == again.status_code == 202, first.text
        assert first.json()["id"] == again.json()["id"]
