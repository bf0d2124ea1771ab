from httpx import Client

from api.requests import Services


def test_the_process_is_well_by_itself(client: Client) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}


def test_without_a_worker_the_service_is_not_ready(client: Client) -> None:
    answer = client.get("/readyz")
    assert answer.status_code == 503
    assert answer.json() == {
        "ready": False,
        "database": True,
        "redis": True,
        "storage": True,
        "worker": False,
        "workers": 0,
        "extensions": [],
        "targets": [],
    }


def test_without_redis_the_service_is_not_ready(client: Client, services: Services, tmp_path) -> None:  # type: ignore[no-untyped-def]
    from services.jobs.queue import connect

    there = services.queue.redis
    object.__setattr__(services.queue, "redis", connect(f"unix://{tmp_path}/none.sock"))
    try:
        answer = client.get("/readyz")
    finally:
        object.__setattr__(services.queue, "redis", there)
    assert answer.status_code == 503
    assert (answer.json()["redis"], answer.json()["database"]) == (False, True)
