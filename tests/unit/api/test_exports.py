"""Exports of jobs that have none. The others are in tests/integration/test_export.py."""

from httpx import Client


def test_a_job_without_a_result_gets_409_in_words(client: Client, finished: str) -> None:
    for path in ("export", "scene.glb?which=before"):
        answer = client.get(f"/v1/jobs/{finished}/{path}")
        assert answer.status_code == 409
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["detail"] == "the job has no result to export: it ended as succeeded"


def test_unknown_jobs_and_scenes_are_refused(client: Client, finished: str) -> None:
    assert client.get("/v1/jobs/nobody/export").status_code == 404
    assert client.get(f"/v1/jobs/{finished}/scene.glb?which=during").status_code == 422
