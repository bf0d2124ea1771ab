"""The re-rendering defence over HTTP: a job, run by a worker's code."""

import base64
import struct
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
import torch
from httpx import Client, Response
from PIL import Image

from scene_attack.analysis.images import pixels, png, save_png
from scene_attack.analysis.records import Rerendering, RerenderingRequest
from scene_attack.runs.analyse import decode_image, rerender_image
from scene_attack.runs.prepare import prepare
from scene_attack_api.requests import Services
from scene_attack_service.jobs.models import Artifact
from scene_attack_service.settings import Settings
from scene_attack_worker.job_process import Jobs
from tests.unit.jobs.small import LIBRARY, SPHERE, spec

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def noisy() -> torch.Tensor:
    """The sphere's image with noise that no parameters explain."""
    original = prepare(spec({"renderer": "torch"}), LIBRARY).original.saved
    noise = torch.randint(-6, 7, original.shape, generator=torch.Generator().manual_seed(0))
    return (original.int() + noise).clamp(0, 255).to(torch.uint8)


def in_base64(image: torch.Tensor) -> str:
    return base64.b64encode(png(image)).decode()


def ended(client: Client, services: Services, settings: Settings, answer: Response) -> dict[str, Any]:
    """The job of a submission, once a worker's code has run it."""
    assert answer.status_code == 202, answer.text
    attempt = services.record.leases.lease(answer.json()["id"], "test", 60)
    assert attempt is not None
    Jobs(settings).run(attempt)
    job: dict[str, Any] = client.get(answer.headers["location"]).json()
    assert job["state"] == "succeeded", job
    return job


def test_an_image_and_its_scene_give_what_the_function_gives(
    client: Client, services: Services, settings: Settings, noisy: torch.Tensor
) -> None:
    body = {"image": {"data": in_base64(noisy)}, "scene": SPHERE, "fit": {"steps": 2}}
    job = ended(client, services, settings, client.post("/v1/rerenderings", json=body))
    assert (job["kind"], job["attack"], job["outcome"]) == ("rerendering", "re-rendering", None)
    found = Rerendering.model_validate(job["result"]["rerendering"])
    expected, rendered = rerender_image(noisy, spec(), RerenderingRequest(steps=2), LIBRARY, lambda *_: None)
    assert found.after.label == expected.after.label
    assert found.losses == pytest.approx(expected.losses, rel=1e-4)
    with Image.open(BytesIO(base64.b64decode(job["result"]["png"]))) as shown:
        assert (pixels(shown).int() - rendered.int()).abs().max() <= 1
    assert client.get(f"/v1/jobs/{job['id']}/artifacts/image").content == png(noisy)
    page = client.get(f"/jobs/{job['id']}").text
    assert f"/v1/jobs/{job['id']}/artifacts/rendering.png" in page
    assert "Re-rendering defence (adam" in page


def test_lists_show_it_if_they_are_asked_to(client: Client, noisy: torch.Tensor) -> None:
    body = {"image": {"data": in_base64(noisy)}, "scene": SPHERE}
    job = client.post("/v1/rerenderings", json=body, headers={"Idempotency-Key": "rerendering"}).json()
    again = client.post("/v1/rerenderings", json=body, headers={"Idempotency-Key": "rerendering"})
    assert again.json()["id"] == job["id"]

    def listed(**asked: str) -> set[str]:
        return {one["id"] for one in client.get("/v1/jobs", params={"limit": "200"} | asked).json()["items"]}

    assert job["id"] not in listed()
    assert job["id"] in listed(kind="rerendering")
    assert job["id"] in listed(q="kind:attack,rerendering")
    assert not listed(kind="rerendering") & listed()
    repeated = client.post(f"/v1/jobs/{job['id']}/retry").json()
    assert (repeated["retry_of"], repeated["spec"], repeated["kind"]) == (job["id"], job["spec"], "rerendering")
    for one in (job, repeated):
        assert client.post(f"/v1/jobs/{one['id']}/cancel").json()["state"] == "cancelled"


def test_a_job_that_is_cancelled_stops_its_fit(
    client: Client, services: Services, settings: Settings, noisy: torch.Tensor
) -> None:
    body = {"image": {"data": in_base64(noisy)}, "scene": SPHERE, "fit": {"steps": 10_000}}  # minutes
    job = client.post("/v1/rerenderings", json=body).json()
    attempt = services.record.leases.lease(job["id"], "test", 60)
    assert attempt is not None

    def cancel() -> None:
        seen = job
        while seen["state"] == "queued" or (seen["progress"] or {"phase": ""})["phase"] == "loading":
            seen = client.get(f"/v1/jobs/{job['id']}").json()
        client.post(f"/v1/jobs/{job['id']}/cancel")

    with ThreadPoolExecutor(1) as pool:
        cancelling = pool.submit(cancel)
        Jobs(settings).run(attempt)
        cancelling.result()
    assert client.get(f"/v1/jobs/{job['id']}").json()["state"] == "cancelled"


def test_a_file_of_a_job_brings_its_scene(
    client: Client, services: Services, settings: Settings, noisy: torch.Tensor, tmp_path: Path
) -> None:
    job, _ = services.record.jobs.create(spec(), 1000, None, lambda _: {})
    assert job is not None
    save_png(noisy, tmp_path / "attacked.png")
    stored = services.store.put(tmp_path / "attacked.png")
    attempt = services.record.leases.lease(job.id, "test", 60)
    assert attempt is not None
    file = Artifact(job_id=job.id, name="attacked.png", sha256=stored.sha256, media_type="image/png", size=stored.size)
    assert services.record.leases.succeed(attempt, {}, {}, [file])
    answer = client.post("/v1/rerenderings", json={"image": {"job": job.id}, "fit": {"steps": 1}})
    assert len(ended(client, services, settings, answer)["result"]["rerendering"]["losses"]) == 2


CUT = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 5) + b"IHDR" + bytes(5) + struct.pack(">I", crc32(b"IHDR" + bytes(5)))
"""A PNG whose header is too short."""
SMALL, FITTING = (in_base64(torch.zeros(size, size, 3, dtype=torch.uint8)) for size in (8, 64))


@pytest.mark.parametrize(
    ("body", "field", "said"),
    [
        ({"image": {"data": SMALL}}, "scene", "needs its scene"),
        ({"image": {"data": "no base64!"}, "scene": SPHERE}, "image.data", "not base64"),
        ({"image": {"data": SMALL}, "scene": SPHERE}, "image", "8×8 pixels"),
        ({"image": {"data": "AAAA"}, "scene": SPHERE}, "image", "not a PNG, JPEG or WebP"),
        ({"image": {"data": base64.b64encode(CUT).decode()}, "scene": SPHERE}, "image", "it is damaged"),
        (
            {"image": {"data": FITTING}, "scene": SPHERE, "target": {"ask": {"question": "what?"}}},
            "target.ask",
            "is asked nothing",
        ),
        ({"image": {"job": "none"}}, "image.job", "no such job"),
        ({"image": {}, "scene": SPHERE}, "image", "either"),
        ({"image": {"data": SMALL, "job": "none"}}, "image", "either"),
        ({"image": {"data": SMALL}, "scene": SPHERE, "fit": {"steps": 0}}, "fit.steps", "1"),
        (
            {"image": {"data": FITTING}, "scene": SPHERE | {"objects": [{"mesh": "primitive/spere"}]}},
            "scene.objects.0.mesh",
            "sphere",
        ),
    ],
)
def test_bad_input_names_the_field(client: Client, body: dict[str, Any], field: str, said: str) -> None:
    answer = client.post("/v1/rerenderings", json=body)
    assert answer.status_code == 422, answer.text
    [error] = answer.json()["errors"]
    assert error["field"] == field
    assert said in error["detail"]


def test_a_form_is_not_json(client: Client) -> None:
    assert client.post("/v1/rerenderings", data={"image": "x"}).status_code == 415


def test_a_jpeg_is_read_and_a_damaged_file_is_not() -> None:
    buffer = BytesIO()
    Image.new("RGB", (6, 4), (10, 20, 30)).save(buffer, format="JPEG")
    assert decode_image(buffer.getvalue(), (4, 6)).shape == (4, 6, 3)
    with pytest.raises(ValueError, match="damaged"):
        decode_image(png(torch.zeros(64, 64, 3, dtype=torch.uint8))[:60], (64, 64))
