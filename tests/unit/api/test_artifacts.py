"""The files of a job, and its exports; those that there are, are in tests/integration/test_export.py."""

import hashlib
from pathlib import Path

import pytest
from httpx import Client

from scene_attack_api.requests import Services

BYTES = b"0123456789"
ETAG = f'"{hashlib.sha256(BYTES).hexdigest()}"'


def get(client: Client, job_id: str, **headers: str):  # type: ignore[no-untyped-def]
    return client.get(f"/v1/jobs/{job_id}/artifacts/original.png", headers=headers)


def test_the_list_says_what_there_is(client: Client, finished: str) -> None:
    assert client.get(f"/v1/jobs/{finished}/artifacts").json() == {
        "items": [{"name": "original.png", "sha256": ETAG.strip('"'), "media_type": "image/png", "size": 10}]
    }


def test_a_file_comes_with_its_hash_and_type(client: Client, finished: str) -> None:
    answer = get(client, finished)
    assert (answer.status_code, answer.content) == (200, BYTES)
    assert answer.headers["etag"] == ETAG
    assert answer.headers["content-type"] == "image/png"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "sandbox" in answer.headers["content-security-policy"]


@pytest.mark.parametrize(
    ("tag", "status"), [(ETAG, 304), (f'"other", {ETAG}', 304), (f"W/{ETAG}", 304), ("*", 304), ('"other"', 200)]
)
def test_a_file_the_client_has_is_not_sent(client: Client, finished: str, tag: str, status: int) -> None:
    answer = get(client, finished, **{"If-None-Match": tag})
    assert answer.status_code == status
    assert answer.headers["etag"] == ETAG
    assert answer.content == (b"" if status == 304 else BYTES)


@pytest.mark.parametrize(
    ("asked", "sent", "said"),
    [
        ("bytes=2-4", b"234", "bytes 2-4/10"),
        ("bytes=7-", b"789", "bytes 7-9/10"),
        ("bytes=-2", b"89", "bytes 8-9/10"),
    ],
)
def test_a_part_of_a_file(client: Client, finished: str, asked: str, sent: bytes, said: str) -> None:
    answer = get(client, finished, Range=asked)
    assert (answer.status_code, answer.content) == (206, sent)
    assert answer.headers["content-range"] == said
    assert answer.headers["etag"] == ETAG


def test_a_part_of_another_version_is_the_whole(client: Client, finished: str) -> None:
    assert get(client, finished, **{"Range": "bytes=2-4", "If-Range": ETAG}).status_code == 206
    assert get(client, finished, **{"Range": "bytes=2-4", "If-Range": '"other"'}).content == BYTES


def test_a_part_beyond_the_end_is_a_problem(client: Client, finished: str) -> None:
    answer = get(client, finished, Range="bytes=20-30")
    assert answer.status_code == 416
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.headers["content-range"] == "bytes */10"
    assert answer.json()["status"] == 416


def test_other_bytes_than_were_stored_are_never_sent(client: Client, services: Services, finished: str) -> None:
    (artifact,) = services.record.jobs.artifacts(finished)
    path = client.get(f"/v1/jobs/{finished}/artifacts/original.png").url.path
    with services.store.open(artifact.sha256) as file:
        stored = Path(str(file.name))
    stored.write_bytes(b"0123456780")
    try:
        for headers in ({}, {"Range": "bytes=0-3"}):
            answer = client.get(path, headers=headers)
            assert answer.status_code == 500
            assert "not those that were stored" in answer.json()["detail"]
        stored.unlink()
        assert client.get(path).status_code == 410
    finally:
        stored.write_bytes(BYTES)


@pytest.mark.parametrize("name", ["none.png", "..%2F..%2Fjobs.sqlite", "original.png%00"])
def test_names_that_are_no_artifacts(client: Client, finished: str, name: str) -> None:
    answer = client.get(f"/v1/jobs/{finished}/artifacts/{name}")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_a_job_without_a_result_gets_409_in_words(client: Client, finished: str) -> None:
    for path in ("export", "scene.glb?which=before"):
        answer = client.get(f"/v1/jobs/{finished}/{path}")
        assert answer.status_code == 409
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["detail"] == "the job has no result to export: it ended as succeeded"


def test_unknown_jobs_and_scenes_are_refused(client: Client, finished: str) -> None:
    assert client.get("/v1/jobs/nobody/export").status_code == 404
    assert client.get(f"/v1/jobs/{finished}/scene.glb?which=during").status_code == 422
