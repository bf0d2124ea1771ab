"""Every route has a rule, and every rule a route."""

import pytest
from fastapi import FastAPI
from fastapi.routing import iter_route_contexts

from api.authentication import RULES, rule_of
from api.main import create_app
from services.access.caller import Scope
from services.settings import Settings
from tests.dashboard_pages import NO_PAGES, PAGES


def routes(app: FastAPI) -> set[str]:
    """Method and path of every route, in the schema or not; HEAD as GET."""
    found = set()
    for route in iter_route_contexts(app.router.routes):
        assert route.path is not None
        for method in route.methods or {"?"}:
            found.add(f"{'GET' if method == 'HEAD' else method} {route.path}")
    return found


def test_every_route_has_a_rule_and_every_rule_a_route() -> None:
    assert routes(create_app(Settings())) == set(RULES)


def test_what_needs_no_key_is_listed_here() -> None:
    assert {route for route, scope in RULES.items() if scope is None} == {
        "GET /healthz",
        "GET /readyz",
        "GET /static/{path:path}",
        "GET /sign-in",
        "POST /sign-in",
        "POST /sign-out",
    }


def test_what_changes_something_needs_a_scope_for_it() -> None:
    for route, scope in RULES.items():
        if scope is not None:
            assert (scope in (Scope.JOBS_READ, Scope.METRICS_READ)) == route.startswith("GET "), route


@pytest.mark.parametrize(
    ("method", "path", "route"),
    [
        ("GET", "/", "GET /"),
        ("GET", "/v1/jobs/", "GET /v1/jobs"),
        ("HEAD", "/v1/jobs/a/artifacts/b.png", "GET /v1/jobs/{job_id}/artifacts/{name}"),
        ("POST", "/jobs/a/cancel", "POST /jobs/{job_id}/cancel"),
        ("DELETE", "/v1/jobs/a", "DELETE /v1/jobs/{job_id}"),
        ("DELETE", "/v1/jobs", None),
        ("GET", "/v1/jobs/a/b/c", None),
        ("GET", "/v1/jobs//events", None),
        ("GET", "//v1/jobs", None),
    ],
)
def test_a_request_has_the_rule_of_its_route(method: str, path: str, route: str | None) -> None:
    found = rule_of(method, path)
    assert (None if found is None else found.route) == route


def test_every_page_is_walked_by_the_accessibility_test() -> None:
    routes = {route.removeprefix("GET ") for route in RULES if route.startswith("GET ")}
    assert set(PAGES) == {path for path in routes if not NO_PAGES.match(path)}
