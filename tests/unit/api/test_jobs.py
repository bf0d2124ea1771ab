import itertools
from concurrent.futures import ThreadPoolExecutor

import psutil
import pytest
from httpx import Client

from scene_attack.client.states import Priority
from scene_attack_api.requests import Services
from scene_attack_api.warm_pool import TooSlow
from tests.processes import command_line
from tests.unit.api.conftest import SPHERE
from tests.unit.jobs.records import attacks

pytestmark = pytest.mark.slow

AZIMUTHS = (0.001 * k for k in itertools.count(1))


def submit(client: Client, **headers: str) -> dict[str, object]:
    answer = client.post("/v1/jobs", json=SPHERE, headers=headers)
    assert answer.status_code == 202, answer.text
    assert answer.headers["location"] == f"/v1/jobs/{answer.json()['id']}"
    found: dict[str, object] = answer.json()
    return found


def test_a_job_is_accepted_and_echoes_the_whole_spec(client: Client) -> None:
    job = submit(client)
    assert job["state"] == "queued"
    assert job["attempt"] == 0
    assert list(job["times"]) == ["queued"]  # type: ignore[call-overload]
    assert job["spec"]["attack"]["delta"] == "measured"  # type: ignore[index]
    assert job["spec"]["scene"]["camera"]["distance"] == 1.8  # type: ignore[index]
    got = client.get(f"/v1/jobs/{job['id']}")
    assert got.json() == job


def test_a_bell_rings_for_it(client: Client, services: Services) -> None:
    bells = services.queue.bells(Priority.HIGH)
    answer = client.post("/v1/jobs?priority=high", json=SPHERE)
    assert answer.status_code == 202
    assert services.queue.bells(Priority.HIGH) == bells + 1


def test_a_key_gets_the_first_answer_and_no_second_job(client: Client, services: Services) -> None:
    first = submit(client, **{"Idempotency-Key": "one"})
    services.record.jobs.request_cancel(str(first["id"]))
    before = len(attacks(services.record))
    assert submit(client, **{"Idempotency-Key": "one"}) == first
    # The same request, written out: what it says counts, not how.
    spelled = SPHERE | {"seed": 0}
    answer = client.post("/v1/jobs", json=spelled, headers={"Idempotency-Key": "one"})
    assert answer.json() == first
    assert len(attacks(services.record)) == before


def test_a_key_with_another_request_is_refused(client: Client) -> None:
    submit(client, **{"Idempotency-Key": "two"})
    answer = client.post("/v1/jobs", json=SPHERE | {"seed": 1}, headers={"Idempotency-Key": "two"})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "Idempotency-Key"


def test_a_key_at_the_same_moment_makes_one_job(client: Client) -> None:
    with ThreadPoolExecutor(4) as pool:
        jobs = list(pool.map(lambda _: submit(client, **{"Idempotency-Key": "three"}), range(4)))
    assert len({job["id"] for job in jobs}) == 1


def test_a_bad_request_does_not_use_its_key_up(client: Client) -> None:
    headers = {"Idempotency-Key": "four"}
    assert client.post("/v1/jobs", json=SPHERE | {"seed": -1}, headers=headers).status_code == 422
    submit(client, **headers)


def test_waiting_ends_when_the_time_is_over(client: Client) -> None:
    answer = client.post("/v1/jobs", json=SPHERE, headers={"Prefer": "respond-async, wait=0"})
    assert answer.status_code == 202
    assert answer.headers["preference-applied"] == "wait=0"


@pytest.mark.parametrize(
    ("prefer", "seconds"),
    [
        (None, None),
        ("wait=5", 5),
        ("respond-async, wait=7", 7),
        ('WAIT="3"; x=y', 3),
        ("wait=100000", 30),
        ("wait=soon", None),
        ("await=5", None),
    ],
)
def test_preferences(prefer: str | None, seconds: float | None) -> None:
    from scene_attack_api.requests import wait_preferred

    assert wait_preferred(prefer) == seconds


def test_pages_by_state(client: Client) -> None:
    job = submit(client)
    client.post(f"/v1/jobs/{job['id']}/cancel")
    page = client.get("/v1/jobs", params={"state": "cancelled", "limit": 1}).json()
    assert [found["id"] for found in page["items"]] == [job["id"]]
    queued = submit(client)
    either = client.get("/v1/jobs", params={"state": ["queued", "cancelled"], "limit": 2}).json()
    assert [found["id"] for found in either["items"]] == [queued["id"], job["id"]]


def test_cancel_is_the_same_however_often_it_is_asked(client: Client) -> None:
    job = submit(client)
    first = client.post(f"/v1/jobs/{job['id']}/cancel")
    assert first.status_code == 202
    assert first.json()["state"] == "cancelled"
    assert client.post(f"/v1/jobs/{job['id']}/cancel").json() == first.json()


def test_more_jobs_than_the_queue_takes_are_put_off(client: Client, services: Services) -> None:
    object.__setattr__(services.submissions, "max_queued", 0)
    try:
        answer = client.post("/v1/jobs", json=SPHERE)
    finally:
        object.__setattr__(services.submissions, "max_queued", 1000)
    assert answer.status_code == 503
    assert answer.headers["content-type"] == "application/problem+json"
    assert int(answer.headers["retry-after"]) > 0


def test_a_lost_warm_process_is_replaced(client: Client) -> None:
    submit(client)
    children = psutil.Process().children()
    warm = [child for child in children if "scene_attack_service.jobs.warm_process" in command_line(child)]
    assert warm
    for child in warm:
        child.kill()
    psutil.wait_procs(warm)  # a request that meets a dying one is answered 503, as many times as there are processes
    assert client.post("/v1/jobs", json=unseen()).status_code == 202


def unseen() -> dict[str, object]:
    """A request that no other is like."""
    camera = SPHERE["scene"]["camera"] | {"azimuth": next(AZIMUTHS)}
    return SPHERE | {"scene": SPHERE["scene"] | {"camera": camera}}


def test_the_seed_of_a_checked_request_stays(client: Client) -> None:
    spec = unseen()
    first = client.post("/v1/jobs", json=spec).json()
    asked = len(client.get("/v1/jobs").json()["items"])
    assert asked
    second = client.post("/v1/jobs", json=spec | {"seed": 5}).json()
    assert (first["checked"], second["checked"]) == (True, True)
    assert second["seed"] == second["spec"]["seed"] == 5
    assert second["spec"] == first["spec"] | {"seed": 5}


def test_a_job_whose_check_takes_too_long_is_accepted_unchecked(
    client: Client, services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def too_slow(*_: object) -> None:
        raise TooSlow

    monkeypatch.setattr(services.pool, "check", too_slow)
    answer = client.post("/v1/jobs", json=unseen())
    named = client.post("/v1/jobs", json={"scene": {"objects": [{"mesh": "furniture/sofaa"}]}})
    assert answer.status_code == 202, answer.text
    assert not answer.json()["checked"]
    assert named.status_code == 422  # names need no process
    assert named.json()["errors"][0]["field"] == "scene.objects.0.mesh"


def test_a_job_is_deleted_once_it_has_ended(client: Client, finished: str) -> None:
    assert client.delete(f"/v1/jobs/{finished}").status_code == 204
    for answer in (client.get(f"/v1/jobs/{finished}"), client.delete(f"/v1/jobs/{finished}")):
        assert answer.status_code == 404
    waiting = submit(client)["id"]
    refused = client.delete(f"/v1/jobs/{waiting}")
    assert refused.status_code == 409
    assert "queued" in refused.json()["detail"]
    assert client.get(f"/v1/jobs/{waiting}").status_code == 200
