"""Requests that a client can send without effort: each has its status, a short answer, and no place on the server."""

import base64
import json
import threading
from pathlib import Path

import pytest
from httpx import Client

from scene_attack.errors import InvalidRequest, without_folders
from scene_attack.runs.spec import parse
from scene_attack_api import requests
from scene_attack_api.requests import Services
from scene_attack_service.jobs.files import ArtifactStore
from scene_attack_service.jobs.models import Artifact
from tests.unit.api.conftest import SPHERE
from tests.unit.jobs.records import OUTCOME

JSON = {"content-type": "application/json"}
MOST_ANSWER = 300_000
"""Bytes of the largest answer to a bad request."""


def nested(depth: int) -> str:
    return "[" * depth + "]" * depth


def filled(text: str, item: str) -> str:
    """The text with `…` replaced by as many items as a body may have."""
    return text.replace("…", ",".join([item] * ((2**20 - 500) // (len(item) + 1))))


BODIES = {
    "groups": ("/v1/jobs", '{"attack": {"renderer": "pyrender", "groups": [{}]}}', 422),
    "a number of groups": ("/v1/jobs", '{"attack": {"renderer": "torch", "groups": 5}}', 422),
    "a number of groups of a campaign": ("/v1/campaigns", '{"grids": [{"attacks": [{"attack": {"groups": 5}}]}]}', 422),
    "renderer": ("/v1/jobs", '{"attack": {"renderer": {}, "method": []}}', 422),
    "bad points": ("/v1/jobs", filled('{"scene": {"lights": {"points": […]}}}', '{"a":1}'), 422),
    "bad points in words": ("/v1/jobs", filled('{"scene": {"lights": {"points": […]}}}', '"x"'), 422),
    "bad questions": ("/v1/jobs", filled('{"target": {"name": "iep", "ask": {"questions": […]}}}', "{}"), 422),
    "bad jobs": ("/v1/campaigns", filled('{"jobs": […]}', "{}"), 422),
    "bad attacks": ("/v1/campaigns", '{"grids": [{"attacks": [' + '{"attack": {"x": 1}},' * 63 + "{}]}]}", 422),
    "a long name": ("/v1/jobs", '{"' + "k" * 1_000_000 + '": 1}', 422),
    "a long method": ("/v1/jobs", '{"attack": {"method": "' + "k" * 1_000_000 + '"}}', 422),
    "NUL in a campaign's name": ("/v1/campaigns", '{"name": "a\\u0000", "grids": []}', 422),
    "NUL in a name of a parameter": ("/v1/jobs", '{"attack": {"bounds": {"a\\u0000": 1}}}', 422),
    "NUL in a job's id": ("/v1/rerenderings", '{"image": {"job": "a\\u0000"}}', 422),
    "a bad image": ("/v1/rerenderings", '{"image": {"job": "' + "k" * 1_000_000 + '"}}', 422),
    **{
        f"nested {depth} in {path} {place}": (path, text.replace("…", nested(depth)), status)
        for depth, status in ((70, 422), (500, 422), (5000, 422))
        for path, place, text in (
            ("/v1/jobs", "scene", '{"scene": …}'),
            ("/v1/jobs", "record", '{"scene": {"source": {"format": "clevr", "record": {"mask": …}}}}'),
            ("/v1/campaigns", "jobs", '{"jobs": [{"scene": …}]}'),
            ("/v1/rerenderings", "image", '{"image": …}'),
        )
    },
}


@pytest.mark.parametrize(("path", "body", "status"), BODIES.values(), ids=BODIES)
def test_a_bad_body_has_a_short_answer(client: Client, path: str, body: str, status: int) -> None:
    answer = client.post(path, content=body, headers=JSON)
    assert answer.status_code == status, answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json"
    assert len(answer.content) < MOST_ANSWER
    assert len(answer.json()["errors"]) <= 100


@pytest.mark.parametrize("depth", range(900, 1000, 9))
def test_depths_at_which_the_stack_ends_somewhere_are_no_mistake_of_the_service(client: Client, depth: int) -> None:
    answer = client.post("/v1/jobs", content=HEAD + nested(depth) + "}}}}", headers=JSON)
    assert answer.status_code == 422


HEAD = '{"scene": {"source": {"format": "clevr", "record": {"mask": '

CURSOR = base64.urlsafe_b64encode(b"2030-01-01T00:00:00+00:00 a" + bytes(1))
NUL = {
    "a path": ("/v1/jobs/a%00b", 404, None),
    "a campaign of a list": ("/v1/jobs?limit=5&campaign=a%00", 422, "campaign"),
    "a cursor": (f"/v1/jobs?cursor={CURSOR.decode()}", 422, "cursor"),
}


@pytest.mark.parametrize(("path", "status", "field"), NUL.values(), ids=NUL)
def test_a_character_that_no_database_stores_is_refused(
    client: Client, path: str, status: int, field: str | None
) -> None:
    answer = client.get(path)
    assert answer.status_code == status
    assert [error["field"] for error in answer.json()["errors"]] == ([] if field is None else [field])


@pytest.mark.parametrize("number", ["9" * 12, "9" * 20, "9" * 5000, "-1", "x"])
def test_numbers_out_of_range_are_refused(client: Client, finished: str, number: str) -> None:
    answer = client.get(f"/v1/jobs/{finished}/events", headers={"last-event-id": number})
    assert answer.status_code == 422, answer.text[:500]
    assert len(answer.content) < 2000


def test_a_number_of_a_campaigns_job_out_of_range_is_refused(client: Client) -> None:
    grid = {"scenes": [SPHERE["scene"]], "attacks": [{"name": "a", "attack": SPHERE["attack"]}]}
    made = client.post("/v1/campaigns", json={"grids": [grid]})
    assert made.status_code == 202, made.text
    assert made.json()["spec"]["grids"][0]["attacks"][0]["name"] == "a"
    path = made.headers["location"]
    assert client.get(f"{path}/jobs", params={"after": 10**20}).status_code == 422
    assert client.post(f"{path}/cancel").status_code == 202


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("DELETE", "/v1/jobs", {"GET", "POST"}),
        ("DELETE", "/v1/campaigns", {"GET", "POST"}),
        ("PUT", "/v1/assets", {"GET", "POST"}),
        ("PUT", "/v1/jobs/none", {"GET", "PATCH", "DELETE"}),
        ("GET", "/v1/jobs/none/cancel", {"POST"}),
        ("POST", "/v1/jobs/none/artifacts/original.png", {"GET", "HEAD"}),
    ],
)
def test_a_wrong_method_is_told_all_the_right_ones(client: Client, method: str, path: str, allowed: set[str]) -> None:
    answer = client.request(method, path)
    assert answer.status_code == 405
    assert set(answer.headers["allow"].split(", ")) == allowed


@pytest.mark.parametrize("headers", [{}, {"range": "bytes=2-5"}, {"if-none-match": "*"}, {"range": "bytes=90-"}])
def test_head_of_a_file_answers_like_get_without_the_file(
    client: Client, finished: str, headers: dict[str, str]
) -> None:
    path = f"/v1/jobs/{finished}/artifacts/original.png"
    get, head = client.get(path, headers=headers), client.head(path, headers=headers)
    assert head.status_code == get.status_code
    assert head.content == b""
    differs = {"date", "x-request-id"}
    assert {k: v for k, v in head.headers.items() if k not in differs} == {
        k: v for k, v in get.headers.items() if k not in differs
    }
    assert client.head(f"/v1/jobs/{finished}/artifacts/none").status_code == 404


def test_no_place_on_the_server_is_told(
    client: Client, services: Services, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def gone(_: ArtifactStore, sha256: str) -> None:
        raise InvalidRequest("image.job", f"[Errno 2] No such file: '{tmp_path}/artifacts/{sha256[:2]}'; see /v1/jobs")

    monkeypatch.setattr(ArtifactStore, "open", gone)
    job = _finished(services)
    answer = client.get(f"/v1/jobs/{job}/artifacts/original.png")
    assert answer.status_code == 422
    assert str(tmp_path.parent) not in answer.text
    assert "see /v1/jobs" in answer.text


def _finished(services: Services) -> str:
    job, _ = services.record.jobs.create(parse(SPHERE), 1000, None, lambda _: {})
    assert job is not None
    attempt = services.record.leases.lease(job.id, "test", 60)
    assert attempt is not None
    file = Artifact(job_id=job.id, name="original.png", sha256="0" * 64, media_type="image/png", size=1)
    services.record.leases.succeed(attempt, {}, OUTCOME, [file])
    return job.id


def test_a_failure_is_recorded_without_folders(client: Client, services: Services, tmp_path: Path) -> None:
    job, _ = services.record.jobs.create(parse(SPHERE), 1000, None, lambda _: {})
    assert job is not None
    attempt = services.record.leases.lease(job.id, "test", 60)
    assert attempt is not None
    services.record.leases.fail(attempt, "internal", f"OSError: cannot read '{tmp_path}/mesh.obj'")
    assert client.get(f"/v1/jobs/{job.id}").json()["failure"]["detail"] == "OSError: cannot read 'mesh.obj'"
    with client.stream("GET", f"/v1/jobs/{job.id}/events") as events:
        assert str(tmp_path) not in events.read().decode()


def test_paths_of_the_api_and_addresses_are_no_folders() -> None:
    text = "GET /v1/targets lists them; https://host/usr/lib/x; ../../etc/passwd; 1/2; 16/32/64"
    assert without_folders(text) == text


@pytest.mark.questions
def test_scenes_to_generate_are_counted_before_they_are_made(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scene_attack_questions.source.generate", None)  # calling it would be a 500
    made = {"format": "clevr", "generate": {"index": 3}}
    answer = client.post("/v1/campaigns", json={"jobs": [{"scene": {"source": made}}] * 500})
    assert answer.status_code == 422
    [error] = answer.json()["errors"]
    assert (error["field"], "grid" in error["detail"]) == ("jobs", True)


def test_a_body_is_parsed_beside_the_other_requests(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """While one body is parsed, which here never ends by itself, another request is answered."""
    answered, begun = threading.Event(), threading.Event()

    def slow(data: object) -> bool:
        if data == {"slow": 1}:
            begun.set()
            assert answered.wait(60)
        return False

    monkeypatch.setattr(requests, "is_nested_deeper", slow)
    statuses: list[int] = []
    post = lambda: statuses.append(client.post("/v1/jobs", content=json.dumps({"slow": 1}), headers=JSON).status_code)  # noqa: E731
    thread = threading.Thread(target=post)
    thread.start()
    assert begun.wait(60)
    assert client.get("/healthz").status_code == 200
    answered.set()
    thread.join()
    assert statuses == [422]


def form(kind: str, value: bytes) -> dict[str, bytes | dict[str, str]]:
    """A multipart form of one field, whose content type is `kind`."""
    body = b'--b\r\ncontent-disposition: form-data; name="kind"\r\n\r\n' + value + b"\r\n--b--\r\n"
    return {"content": body, "headers": {"content-type": kind}}


@pytest.mark.parametrize("path", ["/sign-in", "/v1/assets"])
@pytest.mark.parametrize(
    "kind",
    [
        "multipart/form-data; boundary=b; charset=punycode",
        'Multipart/Form-Data ;charset="PunyCode"; boundary=b',
        "multipart/form-data; boundary=b; charset*=us-ascii'en'punycode; charset=idna",
        "multipart/form-data; boundary=b; charset=undefined",
        "multipart/form-data; boundary=b; charset=utf-7",
        "application/x-www-form-urlencoded; charset=utf-16",
    ],
)
def test_a_form_names_no_codec_but_utf_8(client: Client, path: str, kind: str) -> None:
    # 200,000 characters of punycode take a second to decode, and a million of them minutes.
    answer = client.post(path, **form(kind, b"x-" + b"a" * 50_000))  # type: ignore[arg-type]
    assert (answer.status_code, answer.json()["detail"]) == (415, "a form has to be in UTF-8")


def test_a_form_may_say_that_it_is_utf_8(client: Client) -> None:
    answer = client.post("/v1/assets", **form("multipart/form-data; boundary=b; charset=UTF-8", b"obj"))  # type: ignore[arg-type]
    assert [error["field"] for error in answer.json()["errors"]] == ["file"]


def test_a_form_without_a_file_is_short(client: Client) -> None:
    kind = {"content-type": "application/x-www-form-urlencoded"}
    answer = client.post("/sign-in", content=b"&" * 70_000, headers=kind)
    assert answer.status_code == 413
