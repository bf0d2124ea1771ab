"""Every page in a real browser, light and wide, and dark and narrow: axe-core finds nothing serious, nothing overflows,
the browser has nothing to complain about, and nothing is asked of another site. `out/screenshots` then shows the pages.
"""

from hashlib import sha256
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page

from tests.dashboard_pages import ELSEWHERE, PAGES
from tests.integration.browser import fresh_page
from tests.integration.conftest import Stack, until
from tests.integration.specs import GROUPS, QUICK

pytestmark = pytest.mark.integration

SCREENSHOTS = Path(__file__).parents[2] / "out" / "screenshots"
VENDORED = Path(__file__).parent / "vendor"
AXE = (VENDORED / "axe.min.js").read_text()
RUN = "async () => (await axe.run(document, {resultTypes: ['violations']})).violations"
LOOKS: tuple[tuple[Literal["light", "dark"], int], ...] = (("light", 1440), ("dark", 390))
"""Themes and widths. Colours depend on the theme alone, and the layout on the width alone."""
CAMPAIGN: dict[str, Any] = {
    "name": "accessible",
    "grids": [
        {
            "scenes": {"meshes": ["primitive/sphere"], "views": [0.1, 0.2], "camera": QUICK["scene"]["camera"]},
            "goal": {"truth": "ping-pong ball"},
            "attacks": [
                {"name": "pixels", "attack": QUICK["attack"]},
                {"name": "light", "attack": {"renderer": "pyrender", "groups": ["illumination"], "steps": 1}},
            ],
        }
    ],
}


@pytest.fixture(scope="module")
def filled(stack: Stack) -> dict[str, str]:
    """Two jobs and a campaign that have ended, so that the pages show something."""
    job, groups = [stack.ended(job_id) for job_id in map(stack.submit, (QUICK, GROUPS))]
    for one in (job, groups):
        assert one["state"] == "succeeded", one["failure"]
    answer = stack.client.post("/v1/campaigns", json=CAMPAIGN)
    assert answer.status_code == 202, answer.text
    campaign = answer.json()["id"]
    until(lambda: stack.client.get(f"/v1/campaigns/{campaign}").json()["state"] == "finished", "the campaign ends")
    return {"job_id": job["id"], "groups_id": groups["id"], "campaign_id": campaign}


def test_axe_is_the_file_that_is_listed() -> None:
    assert sha256(AXE.encode()).hexdigest() in (VENDORED / "VENDORED.md").read_text()


@pytest.mark.parametrize("name", [*PAGES, *ELSEWHERE])
def test_a_page_is_accessible(stack: Stack, browser: Browser, filled: dict[str, str], name: str) -> None:
    address = (PAGES | ELSEWHERE)[name].format(**filled)
    with fresh_page(browser) as page:
        complaints = watched(page, str(stack.client.base_url))
        page.goto(f"{stack.client.base_url}{address}")
        page.wait_for_load_state("load")
        page.evaluate(AXE)
        for theme, width in LOOKS:
            page.emulate_media(color_scheme=theme)
            page.set_viewport_size({"width": width, "height": 900})
            save(page, f"{name.strip('/').replace('/', '-') or 'jobs'}-{theme}-{width}.png")
            assert serious(page) == []
            assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), "it scrolls sideways"
        assert complaints == []


def serious(page: Page) -> list[Any]:
    """What axe-core, which the page has loaded, finds serious or worse: the rule and the first nodes."""
    return [
        (one["id"], one["help"], [node["target"] for node in one["nodes"]][:5], one["nodes"][0]["failureSummary"])
        for one in page.evaluate(RUN)
        if one["impact"] in ("serious", "critical")
    ]


def watched(page: Page, origin: str) -> list[str]:
    """What the browser complains about, but for the status 404 of a page that is not there, and requests elsewhere."""
    complaints: list[str] = []
    site = urlsplit(origin).netloc
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda one: complaints.append(one.text) if is_complaint(one) else None)
    page.on("request", lambda one: complaints.append(one.url) if urlsplit(one.url).netloc != site else None)
    return complaints


def is_complaint(message: ConsoleMessage) -> bool:
    missing = "404" in message.text and urlsplit(message.location["url"]).path in ELSEWHERE.values()
    return message.type in ("error", "warning") and not missing


def save(page: Page, name: str) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / name, full_page=True)
