"""The pages about campaigns, assets and targets, in a real browser on the real stack."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.integration.browser import fresh_page, wait_for_images
from tests.integration.conftest import Stack
from tests.integration.test_accessibility import filled, watched
from tests.unit.scenes.test_companion_files import MTL, OBJ

pytestmark = pytest.mark.integration
__all__ = ["filled"]


@pytest.fixture(params=[True, False], ids=["script", "no script"])
def page(request: pytest.FixtureRequest, stack: Stack, browser: Browser) -> Iterator[Page]:
    """A page with and without JavaScript; whatever the browser complains about fails the test."""
    with fresh_page(browser, base_url=str(stack.client.base_url), java_script_enabled=request.param) as page:
        complaints = watched(page, str(stack.client.base_url))
        yield page
    assert [one for one in complaints if "422" not in one] == []  # the browser logs the status of a form's page


def test_a_campaign_s_cell_opens_its_images(page: Page, filled: dict[str, str]) -> None:
    page.goto(f"/campaigns/{filled['campaign_id']}")
    page.get_by_label("Rows").select_option("azimuth")
    page.locator("section[aria-labelledby=heat]").get_by_role("button", name="Show").click()
    table = page.get_by_role("table", name="by azimuth and attack")
    expect(table.locator("tbody tr")).to_have_count(2)
    table.get_by_role("link").first.click()
    images = page.locator("#opened + .pairs img")
    expect(images).to_have_count(2)
    wait_for_images(images)
    page.get_by_role("radio", name="p", exact=True).check()
    expect(page.locator(".charts.by-p")).to_be_visible()
    expect(page.locator(".charts.by-step")).to_be_hidden()


def test_assets_are_narrowed_and_one_is_looked_at(page: Page, filled: dict[str, str]) -> None:
    page.goto("/assets")
    page.get_by_label("Words of the name").fill("sphere")
    page.get_by_label("Kind").select_option("primitive")
    page.get_by_role("button", name="Show").click()
    page.get_by_role("link", name="Sphere", exact=True).click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Sphere")
    expect(page.get_by_role("table").first).to_contain_text("efficientnet-lite0")
    expect(page.locator(f'.strip a[href="/jobs/{filled["job_id"]}"] img')).to_be_visible()


def test_a_mesh_is_added_on_the_page_of_assets(page: Page, tmp_path: Path) -> None:
    (tmp_path / "vase.obj").write_bytes(OBJ)
    (tmp_path / "my chair.mtl").write_bytes(MTL)
    (tmp_path / "broken.obj").write_bytes(b"hello")
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto("/assets")
    page.get_by_text("Add a mesh or a map").click()
    page.get_by_label("Files").set_input_files(tmp_path / "broken.obj")
    page.get_by_label("Credit").fill("Vase by Ada")
    page.get_by_role("button", name="Add", exact=True).click()
    expect(page.get_by_role("alert")).to_contain_text("no vertices")
    expect(page.get_by_label("Credit")).to_have_value("Vase by Ada")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.get_by_label("Files").set_input_files([tmp_path / "vase.obj", tmp_path / "my chair.mtl"])
    page.get_by_role("button", name="Add", exact=True).click()
    expect(page.get_by_role("heading", level=1)).to_have_text("vase")
    expect(page.locator(".facts").first).to_contain_text("Vase by Ada")
    expect(page.locator(".facts").first).to_contain_text("material library my chair.mtl")


def test_targets_show_a_card_for_each_network(page: Page, stack: Stack) -> None:
    page.goto("/")
    page.get_by_role("link", name="Targets").click()
    names = [one["name"] for one in stack.client.get("/v1/targets").json()["items"]]
    expect(page.locator(".card")).to_have_count(len(names))
    expect(page.locator("nav [aria-current=page]")).to_have_text("Targets")
