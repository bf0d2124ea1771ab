"""One person's way through the pages in a real browser, from the form to the files, with nothing but the pages."""

import json
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZipFile

import pytest
from playwright.sync_api import Page, expect

from services.attacks.run import saved_step
from tests.integration.browser import job_state, launched
from tests.integration.conftest import Stack, until
from tests.integration.scene3d_view import SOFTWARE, drawn_after, looking
from tests.integration.specs import long
from tests.integration.test_accessibility import save

pytestmark = pytest.mark.integration


@pytest.fixture
def page(stack: Stack) -> Iterator[Page]:
    """A page that may complain about nothing, and ask nobody but the service."""
    with launched(*SOFTWARE) as browser:
        context = {"base_url": str(stack.client.base_url), "viewport": {"width": 1440, "height": 900}}
        with looking(browser, stack, **context, accept_downloads=True) as page:
            yield page


def test_from_the_form_to_the_files(stack: Stack, page: Page, tmp_path: Path) -> None:
    first = submitted(page, long(10_000))
    until(lambda: saved_step(stack.data / "checkpoints" / first) > 1, "a checkpoint")
    cancelled(page)
    expect(page.get_by_role("heading", name="The best so far")).to_be_visible()
    save(page, "journey-cancelled.png")
    page.get_by_role("button", name="Continue from its checkpoint").click()
    second = another_job(page, first)
    stack.attacking(second)
    cancelled(page)

    done = submitted(page, moving())
    watched_to_its_end(page)
    save(page, "journey-succeeded.png")
    page.get_by_role("button", name="Retry").click()
    repeated = another_job(page, done)
    expect(page.locator("before-after canvas")).to_be_visible()

    page.goto("/?q=state:succeeded&sort=-p")
    for job in (done, repeated):
        page.locator(f"#rows tr[data-id='{job}'] input[type=checkbox]").check()
    page.locator("#compare").click()
    expect(page.locator("h1")).to_have_text("Compare 2 jobs")
    save(page, "journey-compare.png")

    page.goto(f"/jobs/{done}")
    page.locator("#scene3d-details > summary").click()
    expect(page.locator("scene-3d")).to_have_attribute("data-drawings", "1")
    page.locator("scene-3d canvas").focus()
    drawn_after(page, lambda: page.keyboard.press("ArrowLeft"))
    with page.expect_download() as download:
        page.locator("#download-all").click()
    download.value.save_as(tmp_path / "all.zip")
    with ZipFile(tmp_path / "all.zip") as bundle:
        names = {Path(name).name for name in bundle.namelist()}
    assert {"scene_before.glb", "scene_after.glb", "attacked.png", "parameters.json", "README.md"} <= names


def moving() -> dict[str, object]:
    """A job that takes steps for some seconds and moves the object."""
    scene = {"camera": {"size": [64, 64]}, "objects": [{"mesh": "primitive/torus"}]}
    attack = {"renderer": "pyrender", "method": "cma-es", "groups": ["translation", "rotation"], "steps": 40}
    return {"scene": scene, "attack": attack, "goal": {"reach": "tench"}}


def submitted(page: Page, spec: dict[str, object]) -> str:
    """The id of a job that is submitted with the form, whose page is then open."""
    page.goto("/new")
    page.locator("#spec").fill(json.dumps(spec))
    expect(page.locator("#preview-state")).to_contain_text("The network says")
    page.locator("#submit").click()
    return another_job(page, "new")


def another_job(page: Page, before: str) -> str:
    page.wait_for_url(lambda url: "/jobs/" in url and before not in url)
    return page.url.rpartition("/")[2]


def cancelled(page: Page) -> None:
    page.get_by_role("button", name="Cancel this job").click()
    expect(job_state(page)).to_have_text("cancelled")


def watched_to_its_end(page: Page) -> None:
    """The focus stays where it is, and so does what is selected, while the page follows the job."""
    page.locator("#copy-id").focus()
    page.evaluate("getSelection().selectAllChildren(document.querySelector('h1'))")
    chosen = page.evaluate("getSelection().toString()")
    expect(page.locator("before-after canvas")).to_be_visible()
    assert page.evaluate("document.activeElement.id") == "copy-id"
    assert page.evaluate("getSelection().toString()") == chosen != ""
