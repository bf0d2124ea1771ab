"""The re-rendering defence over HTTP, by the process that does it."""

import base64
import struct
from io import BytesIO
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
import torch
from httpx import Client, ReadTimeout
from PIL import Image

from api.state import Services
from services.analysis.images import pixels, png, save_png
from services.analysis.records import Rerendering
from services.analysis.requests import RerenderingRequest
from services.jobs.models import Artifact
from services.pipeline.prepare import prepare
from services.pipeline.rerender import decode_image, rerender_image
from tests.unit.jobs.small import LIBRARY, SPHERE, spec

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def noisy() -> torch.Tensor:
    """The sphere's image with noise that no parameters explain."""
    original = prepare(spec({"renderer": "torch"}), LIBRARY).original
    noise = torch.randint(-6, 7, original.shape, generator=torch.Generator().manual_seed(0))
    return (original.int() + noise).clamp(0, 255).to(torch.uint8)


def in_base64(image: torch.Tensor) -> str:
    return base64.b64encode(png(image)).decode()


def test_an_image_and_its_scene_give_what_the_function_gives(client: Client, noisy: torch.Tensor) -> None:
    body = {"image": {"data": in_base64(noisy)}, "scene": SPHERE, "fit": {"steps": 2}}
    answer = client.post("/v1/rerenderings", json=body)
    assert answer.status_code == 200, answer.text
    found = Rerendering.model_validate(answer.json()["rerendering"])
    expected, rendered = rerender_image(noisy, spec(), RerenderingRequest(steps=2), LIBRARY, lambda *_: None)
    assert found.after.label == expected.after.label
    assert found.losses == pytest.approx(expected.losses, rel=1e-4)
    with Image.open(BytesIO(base64.b64decode(answer.json()["png"]))) as shown:
        assert (pixels(shown).int() - rendered.int()).abs().max() <= 1


def test_a_file_of_a_job_brings_its_scene(
    client: Client, services: Services, noisy: torch.Tensor, tmp_path: Path
) -> None:
    job, _ = services.repository.create(spec(), 1000, None, lambda _: {})
    assert job is not None
    save_png(noisy, tmp_path / "attacked.png")
    stored = services.store.put(tmp_path / "attacked.png")
    attempt = services.repository.lease(job.id, "test", 60)
    assert attempt is not None
    file = Artifact(job_id=job.id, name="attacked.png", sha256=stored.sha256, media_type="image/png", size=stored.size)
    assert services.repository.succeed(attempt, {}, {}, [file])
    answer = client.post("/v1/rerenderings", json={"image": {"job": job.id}, "fit": {"steps": 1}})
    assert answer.status_code == 200, answer.text
    assert len(answer.json()["rerendering"]["losses"]) == 2


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
            {"image": {"data": FITTING}, "scene": SPHERE, "target": {"question": "what?"}},
            "target.question",
            "answers no questions",
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


def test_a_client_that_goes_ends_its_fit(client: Client, noisy: torch.Tensor) -> None:
    body = {"image": {"data": in_base64(noisy)}, "scene": SPHERE, "fit": {"steps": 2}}
    assert client.post("/v1/rerenderings", json=body).status_code == 200  # the process is warm
    long = body | {"fit": {"steps": 10_000}}  # minutes
    with pytest.raises(ReadTimeout):
        client.post("/v1/rerenderings", json=long, timeout=1)
    answers = []
    while not answers or answers[-1] == 503:
        answers.append(client.post("/v1/rerenderings", json=body).status_code)
    assert answers[-1] == 200
    assert len(answers) < 1000
