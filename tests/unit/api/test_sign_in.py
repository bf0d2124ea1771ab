"""A session of the dashboard, as a browser sees it: one cookie."""

from collections.abc import Iterator

import httpx
import pytest

from scene_attack_api.authentication import COOKIE
from scene_attack_service.access.caller import Scope
from tests.unit.api.guarded import CLOSED, Guarded

pytestmark = pytest.mark.slow


@pytest.fixture
def browser(guarded: Guarded) -> Iterator[httpx.Client]:
    """A client without a key that keeps cookies and asks for pages."""
    headers = {"accept": "text/html,application/xml;q=0.9,*/*;q=0.8"}
    with httpx.Client(base_url=guarded.client.base_url, timeout=60, headers=headers) as browser:
        yield browser


def text(guarded: Guarded, caller: str) -> str:
    return guarded.headers[caller]["authorization"].removeprefix("Bearer ")


def sign_in(browser: httpx.Client, key: str, next: str = "/", **headers: str) -> httpx.Response:  # noqa: A002
    return browser.post("/sign-in", data={"key": key, "next": next}, headers=headers)


def test_a_key_is_exchanged_for_a_session(guarded: Guarded, browser: httpx.Client) -> None:
    page = f"/jobs/{guarded.job}"
    refused = browser.get(page)
    assert (refused.status_code, refused.headers["location"]) == (303, f"/sign-in?next=%2Fjobs%2F{guarded.job}")
    form = browser.get(refused.headers["location"])
    assert f'name="next" value="{page}"' in form.text
    answer = sign_in(browser, f" {text(guarded, 'alice')} ", page)
    assert (answer.status_code, answer.headers["location"]) == (303, page)
    assert browser.get(page).status_code == 200
    assert browser.get(f"/v1/jobs/{guarded.job}").status_code == 200  # what the page's script and images ask for
    assert browser.get("/sign-in").headers["location"] == "/"


def test_the_cookie_is_for_this_site_and_no_script_and_is_no_key(guarded: Guarded, browser: httpx.Client) -> None:
    parts = sign_in(browser, text(guarded, "alice")).headers["set-cookie"].lower().split("; ")
    assert {"httponly", "samesite=strict", "path=/"} < set(parts)
    assert "secure" not in parts
    assert text(guarded, "alice").lower() not in str(parts)
    over_tls = sign_in(browser, text(guarded, "alice"), **{"x-forwarded-proto": "https"})
    assert "secure" in over_tls.headers["set-cookie"].lower().split("; ")


@pytest.mark.parametrize("caller", ["unknown", "revoked", "expired"])
def test_a_key_that_is_none_begins_no_session(guarded: Guarded, browser: httpx.Client, caller: str) -> None:
    answer = sign_in(browser, text(guarded, caller))
    assert answer.status_code == 401
    assert "No such key" in answer.text
    assert text(guarded, caller) not in answer.text
    assert not browser.cookies


def test_a_key_that_may_not_read_begins_none_either(guarded: Guarded, browser: httpx.Client) -> None:
    assert sign_in(browser, text(guarded, f"not {Scope.JOBS_READ}")).status_code == 403
    assert not browser.cookies


def test_signing_out_ends_the_session_also_for_a_copy_of_the_cookie(guarded: Guarded, browser: httpx.Client) -> None:
    sign_in(browser, text(guarded, "alice"))
    copy = browser.cookies[COOKIE]
    assert browser.post("/sign-out").headers["location"] == "/sign-in"
    assert not browser.cookies
    assert browser.get("/").status_code == 303
    assert browser.get("/v1/jobs", headers={"cookie": f"{COOKIE}={copy}"}).status_code == 401


def test_a_session_ends_with_its_key(guarded: Guarded, browser: httpx.Client) -> None:
    key, secret = guarded.services.keys.create("brief", "alice", {Scope.JOBS_READ})
    sign_in(browser, secret)
    assert browser.get("/").status_code == 200
    guarded.services.keys.revoke(key.prefix)
    assert browser.get("/").status_code == 303
    assert browser.get("/parts/jobs").status_code == 401  # which the script answers by loading the page again


@pytest.mark.parametrize("route", [route for route, scope in CLOSED.items() if scope is not Scope.JOBS_READ])
def test_a_session_may_do_what_its_key_may(guarded: Guarded, browser: httpx.Client, route: str) -> None:
    sign_in(browser, text(guarded, "only jobs:read"))
    method, path = guarded.place(route)
    assert browser.request(method, path).status_code == 403
    assert guarded.untouched()


FOREIGN = {
    "a form": {"origin": "http://evil.example", "sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"},
    "another port": {"origin": "http://127.0.0.1:1", "sec-fetch-site": "same-site", "sec-fetch-mode": "navigate"},
    "an old browser": {"origin": "http://evil.example"},
    "a sandboxed page": {"origin": "null"},
}


@pytest.mark.parametrize("headers", FOREIGN.values(), ids=FOREIGN)
def test_another_site_can_do_nothing_with_the_session(
    guarded: Guarded, browser: httpx.Client, headers: dict[str, str]
) -> None:
    sign_in(browser, text(guarded, "alice"))
    for path in (f"/jobs/{guarded.job}/cancel", f"/campaigns/{guarded.campaign}/cancel", "/sign-out", "/sign-in"):
        assert browser.post(path, headers=headers).status_code == 403
    assert browser.get("/").status_code == 200
    assert guarded.untouched()


@pytest.mark.parametrize(
    "path",
    ["//evil.example", "/\\evil.example", "https://evil.example", "/\t/evil.example", "evil", "", "/.//x", "/a b"],
)
def test_signing_in_leads_to_no_other_site(guarded: Guarded, browser: httpx.Client, path: str) -> None:
    assert 'name="next" value="/"' in browser.get("/sign-in", params={"next": path}).text
    assert sign_in(browser, text(guarded, "alice"), path).headers["location"] == "/"


def test_a_service_without_keys_has_nobody_sign_in(client: httpx.Client) -> None:
    assert client.get("/sign-in").headers["location"] == "/"
    assert "Sign out" not in client.get("/").text
