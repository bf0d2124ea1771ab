"""Every route and page, asked without a key, with a bad one, and with one that has every scope but the one it needs."""

import pytest

from scene_attack_api.main import create_app
from scene_attack_service.access.caller import Scope
from scene_attack_service.settings import Settings
from tests.unit.api.conftest import serving
from tests.unit.api.guarded import CLOSED, PAGES, Guarded, bearer

pytestmark = pytest.mark.slow

BAD_KEYS = ("none", "unknown", "revoked", "expired", "not a bearer")


@pytest.mark.parametrize("caller", BAD_KEYS)
@pytest.mark.parametrize("route", CLOSED)
def test_without_a_valid_key_nothing_is_answered(guarded: Guarded, route: str, caller: str) -> None:
    answer, nothing = guarded.ask(route, caller), guarded.ask(route, caller, exists=False)
    assert answer.status_code == 401, answer.text
    assert answer.headers["www-authenticate"] == "Bearer"
    assert answer.content == nothing.content  # what exists looks like what does not


@pytest.mark.parametrize("caller", BAD_KEYS)
@pytest.mark.parametrize("route", PAGES)
def test_a_browser_is_sent_to_sign_in_by_what_exists_and_what_does_not(
    guarded: Guarded, route: str, caller: str
) -> None:
    for exists in (True, False):
        method, path = guarded.place(route, exists=exists)
        headers = {"accept": "text/html,*/*;q=0.8"} | guarded.headers[caller]
        answer = guarded.client.request(method, path, headers=headers)
        assert answer.status_code == 303
        assert answer.headers["location"].startswith("/sign-in?")
        assert answer.content == b""


@pytest.mark.parametrize("route", CLOSED)
def test_a_key_without_the_scope_is_refused(guarded: Guarded, route: str) -> None:
    answer = guarded.ask(route, f"not {CLOSED[route]}")
    assert answer.status_code == 403, answer.text
    assert answer.content == guarded.ask(route, f"not {CLOSED[route]}", exists=False).content
    assert CLOSED[route].value in answer.json()["detail"]


ENDLESS = (
    "GET /v1/jobs/{job_id}/events",
    "GET /v1/jobs/{job_id}/artifacts/{name}",
    "GET /v1/jobs/{job_id}/export",
    "GET /v1/jobs/{job_id}/scene.glb",
    "GET /assets/pictures/{asset:path}",
    "GET /compare",
    "GET /compare/campaigns",
    "GET /assets/scenes/{asset:path}",
)
"""Streams that do not end, what a job does not have yet, the picture of a mesh without one, no jobs to compare, and
what another process makes."""


@pytest.mark.parametrize("route", [route for route in CLOSED if route.startswith("GET") and route not in ENDLESS])
def test_a_key_with_the_scope_alone_is_enough(guarded: Guarded, route: str) -> None:
    answer = guarded.ask(route, f"only {CLOSED[route]}")
    assert answer.status_code == 200, answer.text


@pytest.mark.parametrize("path", ["/v2/jobs", "/v1/jobs/none/nothing", "/secret", "/v1"])
def test_what_is_not_listed_is_not_told_from_what_is(guarded: Guarded, path: str) -> None:
    assert guarded.client.get(path).status_code == 401
    assert guarded.client.get(path, headers=guarded.headers["only jobs:read"]).status_code == 404
    assert guarded.client.delete("/v1/jobs", headers=guarded.headers["only jobs:read"]).status_code == 403
    assert guarded.client.delete("/v1/jobs", headers=guarded.headers["admin"]).status_code == 405


@pytest.mark.questions
def test_health_is_open_but_brief(guarded: Guarded) -> None:
    assert guarded.client.get("/healthz").json() == {"status": "ok"}
    brief = guarded.client.get("/readyz").json()
    assert (brief["plugins"], brief["targets"]) == (None, None)
    plugins = guarded.client.get("/readyz", headers=guarded.headers["only jobs:read"]).json()["plugins"]
    assert "questions" in [plugin["name"] for plugin in plugins]


def test_the_key_comes_before_the_body(guarded: Guarded) -> None:
    headers = {"content-type": "application/json"}
    assert guarded.client.post("/v1/jobs", content="{", headers=headers).status_code == 401
    assert guarded.client.post("/v1/jobs", content="{", headers=headers | guarded.headers["admin"]).status_code == 400


HOSTS = {
    **dict.fromkeys(("service.example", "SERVICE.example:80", "127.0.0.1", "[::1]:8008"), 200),
    **dict.fromkeys(("other.example", "service.example.evil.example", "0.0.0.0", "", "[::2]"), 421),
    **dict.fromkeys(("[::1]:x]", "[::1]x", "[localhost]", "[127.0.0.1]", "a@localhost", "localhost:80:80", "::1"), 400),
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
        assert client.get("/v1/jobs", headers=bearer("of another service")).status_code == 200
        key, text = app.state.services.keys.create("first", "alice", {Scope.JOBS_READ})
        assert client.get("/v1/jobs").status_code == 401
        assert client.get("/v1/jobs", headers=bearer(text)).status_code == 200
        app.state.services.keys.revoke(key.prefix)
        assert client.get("/v1/jobs", headers=bearer(text)).status_code == 401
        assert client.get("/v1/jobs").status_code == 401


def test_without_a_key_only_this_machine_is_let_in(redis_url: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    app = create_app(Settings(data=tmp_path_factory.mktemp("here"), redis_url=redis_url))
    with serving(app) as client:
        assert client.get("/v1/jobs").status_code == 200
        # What a proxy on this machine says of a client elsewhere.
        assert client.get("/v1/jobs", headers={"x-forwarded-for": "192.0.2.7"}).status_code == 401
        assert client.get("/healthz", headers={"x-forwarded-for": "192.0.2.7"}).status_code == 200
