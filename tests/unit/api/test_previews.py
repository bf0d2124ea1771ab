"""Previews over HTTP, by the process that makes them."""

import base64
from io import BytesIO
from typing import Any

import pytest
import torch
from httpx import Client
from PIL import Image

from scene_attack.analysis.images import pixels
from scene_attack.runs.prepare import plan, prepare
from scene_attack_api.requests import Services
from scene_attack_api.warm_pool import NoneFree, TooSlow
from tests.unit.jobs.records import attacks
from tests.unit.jobs.small import LIBRARY, SPHERE, spec

pytestmark = pytest.mark.slow

PATH = "/v1/preview"
BODY: dict[str, Any] = {"scene": SPHERE, "attack": {"steps": 3}, "seed": 5}


def test_it_shows_what_a_job_begins_with_and_queues_nothing(client: Client, services: Services) -> None:
    before = attacks(services.record)
    answer = client.post(PATH, json=BODY)
    assert answer.status_code == 200, answer.text
    found = answer.json()
    job = prepare(spec(), LIBRARY)
    with Image.open(BytesIO(base64.b64decode(found["png"]))) as image:
        assert torch.equal(pixels(image), job.original.saved)
    [first] = found["answers"]
    assert first["answer"]["label"] == job.target.labels[int(job.original.logits.argmax())]
    assert len(first["answer"]["top"]) == 5
    assert found["spec"]["seed"] == 5
    assert (found["plan"], found["cost"]) == (None, None)
    assert found["warnings"]
    assert [job.id for job in attacks(services.record)] == [job.id for job in before]


def test_the_plan_and_its_cost_are_made_on_demand(client: Client) -> None:
    found = client.post(PATH, json=BODY, params={"plan": "true"}).json()
    assert found["plan"] == plan(spec(), LIBRARY).model_dump(mode="json")
    assert found["cost"]["steps"] == 3


BAD: list[dict[str, Any]] = [
    {"scene": {"objects": [{"mesh": "primitive/spere"}]}},
    {"scene": {"objects": [{"mesh": "sha256:" + "0" * 64}]}},
    {"scene": {"objects": [{"mesh": "primitive/sphere", "translation": [50, 0, 0]}]}},
    {"scene": SPHERE, "attack": {"steps": "many", "groups": ["nothing"]}},
    {"scene": SPHERE, "goal": {"leave": "grand piano"}},
]


@pytest.mark.parametrize("body", BAD)
def test_a_bad_request_gets_the_answer_of_a_job(client: Client, body: dict[str, Any]) -> None:
    answer, of_job = client.post(PATH, json=body), client.post("/v1/jobs", json=body)
    assert (answer.status_code, answer.json()) == (422, of_job.json())


@pytest.mark.parametrize(("error", "status", "said"), [(TooSlow, 413, "240 s"), (NoneFree, 503, "try again")])
def test_too_little_time_is_said(
    services: Services,
    client: Client,
    monkeypatch: pytest.MonkeyPatch,
    error: type[Exception],
    status: int,
    said: str,
) -> None:
    async def out_of_time(*_: object) -> None:
        raise error

    monkeypatch.setattr(services.pool, "work", out_of_time)
    answer = client.post(PATH, json=BODY)
    assert answer.status_code == status
    assert said in answer.json()["detail"]
    assert ("retry-after" in answer.headers) == (status == 503)


def test_a_form_is_not_json(client: Client) -> None:
    assert client.post(PATH, data={"scene": "x"}).status_code == 415
