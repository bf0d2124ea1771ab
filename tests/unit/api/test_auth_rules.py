"""The scopes that routes need. Those of the API are in openapi.yaml, too."""

import pytest

from scene_attack_api.authentication import scope_of
from scene_attack_service.access.caller import Scope
from tests.dashboard_pages import NO_PAGES, PAGES
from tests.unit.api.guarded import CLOSED, ROUTES


def test_what_needs_no_key_is_listed_here() -> None:
    assert {route for route in ROUTES if route not in CLOSED} == {
        "GET /healthz",
        "GET /readyz",
        "GET /static/{path:path}",
        "GET /sign-in",
        "POST /sign-in",
        "POST /sign-out",
    }


def test_what_changes_something_needs_a_scope_for_it() -> None:
    of_scope = {scope: {route for route in CLOSED if CLOSED[route] is scope} for scope in Scope}
    assert of_scope[Scope.METRICS_READ] == {"GET /metrics"}
    assert of_scope[Scope.ASSETS_WRITE] == {"POST /v1/assets", "DELETE /v1/assets/{sha256}", "POST /assets"}
    assert {route.startswith("GET ") for route in of_scope[Scope.JOBS_READ]} == {True}
    assert {route.startswith("GET ") for route in of_scope[Scope.JOBS_WRITE]} == {False}


@pytest.mark.parametrize(
    ("method", "path", "scope"),
    [
        ("GET", "/", Scope.JOBS_READ),
        ("HEAD", "/v1/jobs/a/artifacts/b.png", Scope.JOBS_READ),
        ("GET", "/metrics/", Scope.METRICS_READ),
        ("GET", "/healthz/", None),
        ("GET", "//healthz", Scope.JOBS_READ),
        ("GET", "/healthz/more", Scope.JOBS_READ),
        ("POST", "/assets/", Scope.ASSETS_WRITE),
        ("POST", "/assetsmore", Scope.JOBS_WRITE),
        ("DELETE", "/v1/jobs", Scope.JOBS_WRITE),
        ("BREW", "/v1/jobs", Scope.JOBS_WRITE),
    ],
)
def test_a_request_has_the_scope_of_its_route(method: str, path: str, scope: Scope | None) -> None:
    assert scope_of(method, path) is scope


def test_every_page_is_walked_by_the_accessibility_test() -> None:
    paths = {route.removeprefix("GET ") for route in ROUTES if route.startswith("GET ")}
    assert set(PAGES) == {path for path in paths if not NO_PAGES.match(path)}
