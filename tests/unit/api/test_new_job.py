"""The page "New job" as its form works without a script, and what the script is given."""

import json
import re
from html import unescape
from typing import Any

import pytest
from httpx import Client

from scene_attack.rendering.declaration import RENDERERS
from scene_attack.runs.spec import JobSpec, parse
from scene_attack_api.requests import Services
from tests.unit.api.conftest import SPHERE
from tests.unit.api.test_assets import PYRAMID
from tests.unit.jobs.records import attacks
from tests.unit.scenes.test_uploaded_maps import TEXELS, exr

HTML = {"accept": "text/html"}


def request_on(page: str) -> Any:
    found = re.search(r"<textarea[^>]*>(.*)</textarea>", page, re.DOTALL)
    assert found is not None
    return json.loads(unescape(found[1]))


def test_the_first_request_can_be_submitted(client: Client) -> None:
    first = parse(request_on(client.get("/new", headers=HTML).text))
    assert (first.attack.groups, first.attack.method, first.attack.truncation) == (("bump",), "fgsm", None)


def test_a_mesh_may_be_named_in_the_address(client: Client) -> None:
    page = client.get("/new", headers=HTML, params={"mesh": "primitive/sphere"}).text
    assert request_on(page)["scene"]["objects"] == [{"mesh": "primitive/sphere"}]


def test_a_job_is_cloned(client: Client, services: Services) -> None:
    spec = parse(SPHERE | {"seed": 7})
    job, _ = services.record.jobs.create(spec, 1000, None, lambda _: {})
    assert job is not None
    page = client.get("/new", headers=HTML, params={"from": job.id}).text
    assert parse(request_on(page)) == spec
    assert f'href="/jobs/{job.id}"' in page


def test_a_clone_of_no_job_is_not_found(client: Client) -> None:
    assert client.get("/new", headers=HTML, params={"from": "none"}).status_code == 404


def test_the_form_queues_a_job_and_leads_to_its_page(client: Client, services: Services) -> None:
    answer = client.post("/new", data={"spec": json.dumps(SPHERE)}, headers=HTML)
    assert answer.status_code == 303, answer.text
    found = re.fullmatch(r"/jobs/(\w+)", answer.headers["location"])
    assert found is not None
    job = services.record.jobs.get(found[1])
    assert job is not None
    assert JobSpec.model_validate(job.spec).attack.steps == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "body</code>: it is not JSON"),
        ("[" * 80 + "]" * 80, "body</code>: it is nested deeper"),
        (json.dumps(SPHERE | {"seed": -1, "attack": {"steps": 0}}), "seed</code>"),
        (json.dumps(SPHERE | {"seed": -1, "attack": {"steps": 0}}), "attack.steps</code>"),
        (json.dumps({"scene": {"objects": [{"mesh": "primitive/spere"}]}}), "scene.objects.0.mesh</code>"),
    ],
)
def test_a_wrong_request_is_shown_again_with_its_errors(
    client: Client, services: Services, text: str, said: str
) -> None:
    before = len(attacks(services.record))
    answer = client.post("/new", data={"spec": text}, headers=HTML)
    assert answer.status_code == 422
    assert said in answer.text
    assert unescape(answer.text[answer.text.index("<textarea") :]).count(text) == 1
    assert len(attacks(services.record)) == before


def test_the_script_gets_every_name_that_a_field_may_have(client: Client) -> None:
    found = client.get("/new/choices.json").json()
    assert found["schema"] == JobSpec.model_json_schema()
    assert "rubber" in [name for name, _ in found["materials"]]
    meshes = {mesh["name"]: mesh for mesh in found["meshes"]}
    assert meshes["primitive/sphere"]["picture"] == "/assets/pictures/primitive/sphere"
    targets = {target["name"]: target for target in found["targets"]}
    assert (targets["efficientnet-lite0"]["gradient"], targets["efficientnet-lite0"]["question"]) == (True, None)


def test_the_script_gets_the_groups_with_their_ranges_and_the_methods_that_fit(client: Client) -> None:
    found = client.get("/new/choices.json").json()["renderers"]
    assert next(iter(found)) == "torch"  # which has natural ranges
    for name, declared in RENDERERS.items():
        groups = {group["name"]: group for group in found[name]["groups"]}
        assert tuple(groups) == declared.group_names
        assert [name for name in groups if groups[name]["natural_range"]] == list(declared.natural_groups)
        assert [name for name in groups if groups[name]["by_default"]] == list(declared.default_groups)
        assert {name: groups[name]["limit"] for name in groups} == {
            group.name: group.suggested_limit for group in declared.groups
        }
        assert found[name]["words"]
        assert all(group["explanation"] or group["natural_range"] for group in groups.values())
    assert found["torch"]["fits"]["square"] == ["normals"]  # it needs values at each pixel
    assert found["torch"]["fits"]["natural-gradient"] == []  # it is for renderers without gradients
    assert "rotation" in found["pyrender"]["fits"]["natural-gradient"]


def test_uploaded_meshes_come_first(client: Client) -> None:
    sent = client.post("/v1/assets", files=[("file", ("p.off", PYRAMID))])
    assert sent.status_code == 201, sent.text
    meshes = client.get("/new/choices.json").json()["meshes"]
    uploads = [mesh["name"] for mesh in meshes if mesh["kind"] == "upload"]
    assert sent.json()["name"] in uploads
    assert [mesh["name"] for mesh in meshes][: len(uploads)] == uploads


def test_a_map_that_was_uploaded_is_a_light_and_no_mesh(client: Client) -> None:
    sent = client.post("/v1/assets", files=[("file", ("garden.exr", exr(TEXELS)))], data={"name": "Garden"})
    assert sent.status_code == 201, sent.text
    found = client.get("/new/choices.json").json()
    named = [sent.json()["name"], "Garden"]
    assert named in found["environments"]
    assert named[0] not in [mesh["name"] for mesh in found["meshes"]]
