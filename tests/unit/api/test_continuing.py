"""Continuing a job that ended before its time."""

from httpx import Client

from scene_attack.runs.result import CHECKPOINT
from scene_attack.runs.spec import parse
from scene_attack_api.requests import Services
from scene_attack_service.jobs.models import Artifact, Job
from tests.unit.api.conftest import SPHERE


def cancelled(services: Services, *names: str) -> Job:
    """A job that was cancelled while it ran, with these files."""
    job, _ = services.record.jobs.create(parse(SPHERE), 1000, None, lambda _: {})
    assert job is not None
    attempt = services.record.leases.lease(job.id, "test", 60)
    assert attempt is not None
    services.record.jobs.request_cancel(job.id)
    files = [
        Artifact(job_id=job.id, name=name, sha256="ab" * 32, media_type="application/octet-stream", size=3)
        for name in names
    ]
    assert services.record.leases.cancelled(attempt, files)
    return job


def test_another_job_goes_on_from_the_checkpoint(client: Client, services: Services) -> None:
    job = cancelled(services, CHECKPOINT, "original.png")
    answer = client.post(f"/v1/jobs/{job.id}/continue")
    assert answer.status_code == 202, answer.text
    found = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{found['id']}"
    assert found["id"] != job.id
    assert found["state"] == "queued"
    assert found["spec"] == client.get(f"/v1/jobs/{job.id}").json()["spec"]
    files = client.get(f"/v1/jobs/{found['id']}/artifacts").json()["items"]
    assert [(one["name"], one["sha256"]) for one in files] == [(CHECKPOINT, "ab" * 32)]
    assert client.get(f"/v1/jobs/{job.id}").json()["state"] == "cancelled"


def test_what_cannot_be_continued_says_why(client: Client, services: Services, finished: str) -> None:
    queued = client.post("/v1/jobs", json=SPHERE).json()["id"]
    for job_id, status, words in (
        (queued, 409, "the job is queued; one that was cancelled or failed can be continued"),
        (finished, 409, "the job is succeeded"),
        (cancelled(services).id, 409, "ended before its first checkpoint"),
        ("none", 404, "there is no such job"),
    ):
        answer = client.post(f"/v1/jobs/{job_id}/continue")
        assert answer.status_code == status
        assert words in answer.json()["detail"]


def test_the_button_of_the_page_leads_to_the_new_job(client: Client, services: Services) -> None:
    job = cancelled(services, CHECKPOINT)
    assert f'action="/jobs/{job.id}/continue"' in client.get(f"/jobs/{job.id}").text
    answer = client.post(f"/jobs/{job.id}/continue")
    assert answer.status_code == 303
    assert client.get(answer.headers["location"]).status_code == 200
    assert "/continue" not in client.get(f"/jobs/{cancelled(services).id}").text
    assert "Goes on from the checkpoint of" in client.get(answer.headers["location"]).text
    repeated = client.post(f"/jobs/{job.id}/retry").headers["location"]
    assert "Repeats" in client.get(repeated).text


def test_a_job_without_a_result_is_compared_by_what_it_has(client: Client, services: Services) -> None:
    row = {"queries": 4, "seconds": 0.1, "advantage": 1.5, "perceptibility": 0.25, "distance": 0.5, "loss": 0.99995}
    jobs = []
    for _ in range(2):
        job, _ = services.record.jobs.create(parse(SPHERE), 1000, None, lambda _: {})
        assert job is not None
        attempt = services.record.leases.lease(job.id, "test", 60)
        assert attempt is not None
        services.record.leases.progress(attempt, "attacking", 1, 2, [row | {"step": step} for step in (0, 1)])
        services.record.jobs.request_cancel(job.id)
        files = [Artifact(job_id=job.id, name="attacked.png", sha256="ab" * 32, media_type="image/png", size=3)]
        services.record.leases.cancelled(attempt, files)
        jobs.append(job.id)
    page = client.get(f"/compare?jobs={jobs[0]},{jobs[1]}").text
    assert f"/v1/jobs/{jobs[1]}/artifacts/attacked.png" in page
    assert "original.png" not in page
    assert page.count("against queries; at the end: A") == 4
    assert ">0.9999" not in page  # the axis of a probability is from 0 to 1
