"""A person who asks for a page gets its errors as pages; a program gets problem documents."""

import pytest

from scene_attack_api.problems import MEDIA_TYPE
from scene_attack_service.access.caller import Scope
from tests.unit.api.dashboard_records import Tags
from tests.unit.api.guarded import CLOSED, PAGES, Guarded

pytestmark = pytest.mark.slow

BROWSER = {"accept": "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"}
NO_BROWSER = ["*/*", "application/json", "text/html;q=0, */*", "application/text/html"]
OWNED_PAGES = [route for route in PAGES if "_id}" in route]


@pytest.mark.parametrize("route", OWNED_PAGES)
def test_what_is_not_there_is_a_page_for_a_browser(guarded: Guarded, route: str) -> None:
    method, path = guarded.place(route)
    answer = guarded.client.request(method, path, headers=BROWSER | guarded.headers["bob"])
    assert answer.status_code == 404
    assert answer.headers["content-type"].startswith("text/html")
    assert "style-src 'self'" in answer.headers["content-security-policy"]
    assert "accept" in answer.headers["vary"].lower()
    tags = Tags(answer.text)
    assert "Not Found" in tags.text
    assert "There is no such" in tags.text
    assert tags.all("link")


@pytest.mark.parametrize("route", PAGES)
def test_what_is_forbidden_is_a_page_for_a_browser(guarded: Guarded, route: str) -> None:
    method, path = guarded.place(route)
    other = "only jobs:write" if CLOSED[route] is Scope.ASSETS_WRITE else "only assets:write"
    answer = guarded.client.request(method, path, headers=BROWSER | guarded.headers[other])
    assert answer.status_code == 403
    assert answer.headers["content-type"].startswith("text/html")
    assert "insufficient_scope" in answer.headers["www-authenticate"]
    tags = Tags(answer.text)
    assert str(CLOSED[route]) in tags.text
    assert any(button.get("id") == "sign-out" for button in tags.all("button"))


@pytest.mark.parametrize("accept", NO_BROWSER)
@pytest.mark.parametrize(("caller", "status"), [("bob", 404), ("only assets:write", 403)])
def test_a_program_gets_a_problem(guarded: Guarded, accept: str, caller: str, status: int) -> None:
    answer = guarded.client.get(f"/jobs/{guarded.job}", headers={"accept": accept} | guarded.headers[caller])
    assert answer.status_code == status
    assert answer.headers["content-type"] == MEDIA_TYPE
    assert "accept" in answer.headers["vary"].lower()


@pytest.mark.parametrize("path", ["/v1/jobs/none", "/v1/none", "/openapi.json"])
def test_the_api_answers_a_browser_as_it_answers_programs(guarded: Guarded, path: str) -> None:
    answer = guarded.client.get(path, headers=BROWSER | guarded.headers["only jobs:write"])
    assert answer.status_code in (403, 404)
    assert answer.headers["content-type"] == MEDIA_TYPE


ELSE = {
    "/?sort=sleeping": ("alice", 422),
    "/nothing": ("alice", 404),
    "/jobs/nothing": ("alice", 404),
    "/jobs/nothing/more": ("alice", 404),
    "/campaigns/nothing": ("alice", 404),
    "/assets/nothing": ("alice", 404),
    "/targets/nothing": ("alice", 404),
    "/docs/nothing": ("alice", 404),
    "/v2/nothing": ("alice", 404),
    "/static/nothing": ("none", 404),
    "/parts/jobs/nothing": ("alice", 404),
    "/parts/jobs": ("none", 401),
}


@pytest.mark.parametrize("path", ELSE)
def test_other_errors_are_pages_too(guarded: Guarded, path: str) -> None:
    caller, status = ELSE[path]
    answer = guarded.client.get(path, headers=BROWSER | guarded.headers[caller])
    assert answer.status_code == status
    assert len(Tags(answer.text).all("h1")) == 1


def test_an_unknown_host_is_a_page_and_what_it_says_is_text(guarded: Guarded) -> None:
    answer = guarded.client.get("/", headers=BROWSER | {"host": "evil.example"})
    assert answer.status_code == 421
    assert "evil.example" in Tags(answer.text).text


@pytest.mark.parametrize(
    ("path", "accept", "kind"),
    [
        ("/assets", BROWSER["accept"], "text/html"),
        ("/assets", "application/json", MEDIA_TYPE),
        ("/v1/scenes", BROWSER["accept"], MEDIA_TYPE),
    ],
)
def test_a_mistake_of_the_service_is_a_page_too(
    guarded: Guarded, monkeypatch: pytest.MonkeyPatch, path: str, accept: str, kind: str
) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("password is 1234")

    monkeypatch.setattr(guarded.services.library, "entries", broken)
    answer = guarded.client.get(path, headers={"accept": accept} | guarded.headers["alice"])
    assert answer.status_code == 500
    assert answer.headers["content-type"].startswith(kind)
    assert answer.headers["x-request-id"]
    assert answer.headers["connection"] == "close"
    assert "1234" not in answer.text
    if kind == "text/html":
        tags = Tags(answer.text)
        assert "Internal Server Error" in tags.text
        assert "its log says which" in tags.text
        assert "default-src 'none'" in answer.headers["content-security-policy"]
