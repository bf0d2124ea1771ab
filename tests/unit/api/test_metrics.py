"""Health of the service, and what Prometheus reads, in its own parser."""

import pytest
from httpx import Client
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy import create_engine

from scene_attack_api.requests import Services
from scene_attack_api.routes.service import ServiceMetrics
from scene_attack_service.jobs.database import Database
from scene_attack_service.jobs.queue import Queue, connect
from scene_attack_service.jobs.statistics import Figures


def test_the_process_is_well_by_itself(client: Client) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}


@pytest.mark.questions
def test_without_a_worker_the_service_is_not_ready(client: Client) -> None:
    answer = client.get("/readyz")
    assert answer.status_code == 503
    found = answer.json()
    assert "questions" in [plugin["name"] for plugin in found.pop("plugins")]
    assert found == {
        "ready": False,
        "database": True,
        "redis": True,
        "storage": True,
        "worker": False,
        "workers": 0,
        "targets": [],
    }


def test_without_redis_the_service_is_not_ready(client: Client, services: Services, tmp_path) -> None:  # type: ignore[no-untyped-def]
    there = services.queue.redis
    object.__setattr__(services.queue, "redis", connect(f"unix://{tmp_path}/none.sock"))
    try:
        answer = client.get("/readyz")
    finally:
        object.__setattr__(services.queue, "redis", there)
    assert answer.status_code == 503
    assert (answer.json()["redis"], answer.json()["database"]) == (False, True)


def samples(client: Client) -> dict[tuple[str, ...], float]:
    answer = client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=")
    found = {}
    for family in text_string_to_metric_families(answer.text):
        for sample in family.samples:
            found[sample.name, *(value for _, value in sorted(sample.labels.items()))] = sample.value
    return found


def test_requests_are_counted_by_the_template_of_their_route(client: Client, finished: str) -> None:
    before = samples(client)
    for _ in range(3):
        client.get(f"/v1/jobs/{finished}/artifacts")
    client.get("/v1/jobs/none/artifacts")
    client.get("/no/such/path")
    client.request("PROPFIND", "/no/such/path")
    client.get("/campaigns/none")
    after = samples(client)
    counted = {key: value - before.get(key, 0) for key, value in after.items() if key[0].endswith("requests_total")}
    assert {key[1:]: value for key, value in counted.items() if value} == {
        ("GET", "/v1/jobs/{job_id}/artifacts", "200"): 3,
        ("GET", "/v1/jobs/{job_id}/artifacts", "404"): 1,
        ("GET", "none", "404"): 1,
        ("other", "none", "404"): 1,
        ("GET", "/campaigns/{campaign_id}", "404"): 1,
        ("GET", "/metrics", "200"): 1,
    }
    timed = "scene_attack_http_request_seconds_count", "GET", "/v1/jobs/{job_id}/artifacts"
    assert after[timed] - before.get(timed, 0) == 4


@pytest.mark.usefixtures("finished")
def test_the_service_is_reported_from_the_record(client: Client) -> None:
    found = samples(client)
    assert found["scene_attack_jobs", "attack", "succeeded"] >= 1
    assert found["scene_attack_jobs_ended_total", "attack", "succeeded"] >= 1
    assert found["scene_attack_queries_total",] >= 4
    assert found["scene_attack_stage_seconds_count", "waiting"] >= 1
    assert found["scene_attack_stage_seconds_bucket", "+Inf", "waiting"] >= 1
    assert found["scene_attack_workers",] == 0
    assert found["scene_attack_up", "database"] == found["scene_attack_up", "redis"] == 1
    assert found["process_resident_memory_bytes",] > 0


def test_a_new_format_is_given_to_those_who_ask(client: Client) -> None:
    answer = client.get("/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"})
    assert answer.headers["content-type"].startswith("application/openmetrics-text")
    assert answer.text.endswith("# EOF\n")


@pytest.mark.parametrize("version", ["abc", "..", ""])
def test_a_version_that_is_none_gets_the_format_of_all(client: Client, version: str) -> None:
    answer = client.get("/metrics", headers={"Accept": f"application/openmetrics-text; version={version}"})
    assert answer.status_code == 200
    assert "scene_attack_up" in answer.text


def test_metrics_say_what_is_away() -> None:
    nowhere = Database(create_engine("sqlite:////no/such/folder/jobs.sqlite"))
    away = ServiceMetrics(Figures(nowhere), Queue(connect("redis://127.0.0.1:1")), int)
    [up] = [metric for metric in away.collect() if metric.name == "scene_attack_up"]
    assert {sample.labels["part"]: sample.value for sample in up.samples} == {"database": 0, "redis": 0}
