"""Every route and page, asked without a key, with a bad one, and with one that has every scope but the one it needs."""

from collections.abc import Iterator
from dataclasses import dataclass

import httpx
import pytest
from fastapi import FastAPI

from api.auth_rules import RULES
from api.main import create_app
from api.state import Services
from services.access.caller import Scope
from services.jobs.models import State
from services.pipeline.spec import parse
from services.settings import Settings
from tests.unit.api.conftest import SPHERE, serving

CLOSED = {route: scope for route, scope in RULES.items() if scope is not None}
NAMES = {"name": "original.png", "move": "pause", "campaign_id": "none"}
BAD_KEYS = ("none", "unknown", "revoked", "expired", "not a bearer")


@dataclass(frozen=True)
class Guarded:
    """A service that has keys: a client without one, the headers of each kind of caller, and the id of a job."""

    client: httpx.Client
    headers: dict[str, dict[str, str]]
    job: str

    def ask(self, route: str, caller: str, job: str | None = None) -> httpx.Response:
        """The answer to a request for a route ("GET /v1/jobs/{job_id}")."""
        method, path = route.split(" ")
        filled = path.format(**NAMES, job_id=self.job if job is None else job)
        return self.client.request(method, filled, headers=self.headers[caller])


@pytest.fixture(scope="module")
def app(redis_url: str, tmp_path_factory: pytest.TempPathFactory) -> FastAPI:
    return create_app(Settings(data=tmp_path_factory.mktemp("data"), redis_url=redis_url, hosts="service.example"))


@pytest.fixture(scope="module")
def guarded(app: FastAPI) -> Iterator[Guarded]:
    with serving(app) as client:
        services = app.state.services
        assert isinstance(services, Services)
        job, _ = services.repository.create(parse(SPHERE), 1000, None, lambda _: {})
        assert job is not None
        headers = {"none": {}, "unknown": _bearer("sa_0123456789_" + "x" * 43)}
        for name, scopes, seconds in [
            ("admin", {Scope.ADMIN}, None),
            ("revoked", {Scope.ADMIN}, None),
            ("expired", {Scope.ADMIN}, 0.0),
            *((f"only {scope}", {scope}, None) for scope in Scope),
            *((f"not {scope}", set(Scope) - {scope, Scope.ADMIN}, None) for scope in Scope),
        ]:
            key, text = services.keys.create(name, "alice", scopes, seconds)
            headers[name] = _bearer(text)
            if name == "revoked":
                services.keys.revoke(key.prefix)
        headers["not a bearer"] = {"authorization": headers["admin"]["authorization"].replace("Bearer", "Basic")}
        yield Guarded(client, headers, job.id)
        found = services.repository.get(job.id)
        assert found is not None
        assert found.state is State.QUEUED  # whoever asked for it, nobody cancelled it


def _bearer(text: str) -> dict[str, str]:
    return {"authorization": f"Bearer {text}"}


@pytest.mark.parametrize("caller", BAD_KEYS)
@pytest.mark.parametrize("route", CLOSED)
def test_without_a_valid_key_nothing_is_answered(guarded: Guarded, route: str, caller: str) -> None:
    answer = guarded.ask(route, caller)
    assert answer.status_code == 401, answer.text
    assert answer.headers["www-authenticate"] == "Bearer"
    assert answer.content == guarded.ask(route, caller, job="none").content  # what exists looks like what does not


@pytest.mark.parametrize("route", CLOSED)
def test_a_key_without_the_scope_is_refused(guarded: Guarded, route: str) -> None:
    answer = guarded.ask(route, f"not {CLOSED[route]}")
    assert answer.status_code == 403, answer.text
    assert answer.content == guarded.ask(route, f"not {CLOSED[route]}", job="none").content
    assert CLOSED[route].value in answer.json()["detail"]


@pytest.mark.parametrize("route", [route for route in CLOSED if route.startswith("GET") and "campaign_id" not in route])
def test_a_key_with_the_scope_alone_is_enough(guarded: Guarded, route: str) -> None:
    answer = guarded.ask(route.replace("/events", "").replace("/{name}", ""), f"only {CLOSED[route]}")
    assert answer.status_code == 200, answer.text


@pytest.mark.parametrize("path", ["/v2/jobs", "/v1/jobs/none/nothing", "/secret", "/v1"])
def test_what_is_not_listed_is_not_told_from_what_is(guarded: Guarded, path: str) -> None:
    assert guarded.client.get(path).status_code == 401
    assert guarded.client.get(path, headers=guarded.headers["only jobs:read"]).status_code == 404
    assert guarded.client.delete("/v1/jobs", headers=guarded.headers["only jobs:read"]).status_code == 404
    assert guarded.client.delete("/v1/jobs", headers=guarded.headers["admin"]).status_code == 405


def test_health_is_open_but_brief(guarded: Guarded) -> None:
    assert guarded.client.get("/healthz").json() == {"status": "ok"}
    brief = guarded.client.get("/readyz").json()
    assert (brief["extensions"], brief["targets"]) == (None, None)
    assert guarded.client.get("/readyz", headers=guarded.headers["only jobs:read"]).json()["extensions"] == []


def test_the_key_comes_before_the_body(guarded: Guarded) -> None:
    headers = {"content-type": "application/json"}
    assert guarded.client.post("/v1/jobs", content="{", headers=headers).status_code == 401
    assert guarded.client.post("/v1/jobs", content="{", headers=headers | guarded.headers["admin"]).status_code == 400


HOSTS = {
    **dict.fromkeys(("service.example", "SERVICE.example:80", "127.0.0.1", "[::1]:8008"), 200),
    **dict.fromkeys(("other.example", "service.example.evil.example", "0.0.0.0", ""), 421),
}


@pytest.mark.parametrize(("host", "status"), HOSTS.items())
def test_only_known_hosts_are_answered(guarded: Guarded, host: str, status: int) -> None:
    assert guarded.client.get("/healthz", headers={"host": host}).status_code == status


FETCHED = {
    "an image": {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors", "sec-fetch-dest": "image"},
    "a script": {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors", "sec-fetch-dest": "script"},
    "another port": {"sec-fetch-site": "same-site", "sec-fetch-mode": "cors", "sec-fetch-dest": "empty"},
    "a frame": {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "iframe"},
}
LINK = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "document"}


@pytest.mark.parametrize("fetched", FETCHED.values(), ids=FETCHED)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_another_site_has_nothing_fetched(guarded: Guarded, method: str, fetched: dict[str, str]) -> None:
    headers = fetched | guarded.headers["admin"]
    assert guarded.client.request(method, "/v1/jobs", headers=headers).status_code == 403


def test_a_link_from_another_site_is_followed_and_its_form_is_not(guarded: Guarded) -> None:
    headers = LINK | guarded.headers["admin"]
    assert guarded.client.get("/", headers=headers).status_code == 200
    assert guarded.client.post(f"/jobs/{guarded.job}/cancel", headers=headers).status_code == 403
    assert guarded.client.get(f"/v1/jobs/{guarded.job}", headers=guarded.headers["admin"]).json()["state"] == "queued"


def test_the_first_key_closes_the_service_and_the_last_revocation_does_not_open_it(
    redis_url: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    app = create_app(Settings(data=tmp_path_factory.mktemp("first"), redis_url=redis_url))
    with serving(app) as client:
        assert client.get("/v1/jobs").status_code == 200
        assert client.get("/v1/jobs", headers=_bearer("of another service")).status_code == 200
        key, text = app.state.services.keys.create("first", "alice", {Scope.JOBS_READ})
        assert client.get("/v1/jobs").status_code == 401
        assert client.get("/v1/jobs", headers=_bearer(text)).status_code == 200
        app.state.services.keys.revoke(key.prefix)
        assert client.get("/v1/jobs", headers=_bearer(text)).status_code == 401
        assert client.get("/v1/jobs").status_code == 401


def test_without_a_key_only_this_machine_is_let_in(redis_url: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    app = create_app(Settings(data=tmp_path_factory.mktemp("here"), redis_url=redis_url))
    with serving(app) as client:
        assert client.get("/v1/jobs").status_code == 200
        # What a proxy on this machine says of a client elsewhere.
        assert client.get("/v1/jobs", headers={"x-forwarded-for": "192.0.2.7"}).status_code == 401
        assert client.get("/healthz", headers={"x-forwarded-for": "192.0.2.7"}).status_code == 200
