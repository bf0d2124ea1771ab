"""Every page is in the list that the accessibility test walks."""

from api.authentication import RULES
from tests.dashboard_pages import NO_PAGES, PAGES


def test_every_page_is_walked_by_the_accessibility_test() -> None:
    routes = {route.removeprefix("GET ") for route in RULES if route.startswith("GET ")}
    assert set(PAGES) == {path for path in routes if not NO_PAGES.match(path)}
