"""A real browser for tests of pages, which waits as long as a loaded machine needs."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Browser, Locator, Page, expect, sync_playwright

from tests.integration.conftest import PATIENCE, until

ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@contextmanager
def launched(*more: str) -> Iterator[Browser]:
    """The machine's Chromium, with `more` arguments."""
    expect.set_options(timeout=1000 * PATIENCE)  # 5 s by default
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=[*ARGUMENTS, *more])
        yield browser
        browser.close()


@contextmanager
def fresh_page(browser: Browser, **options: Any) -> Iterator[Page]:
    """A page of a fresh profile. `options` are those of `Browser.new_context`."""
    with browser.new_context(**options) as context:
        context.set_default_timeout(1000 * PATIENCE)  # 30 s by default
        yield context.new_page()


def job_state(page: Page) -> Locator:
    """The badge of the state on a job's page, whose other badges come and go."""
    return page.locator(".badges .badge[class*='state-']")


def wait_for_images(images: Locator) -> None:
    """Waits until every image is loaded. One that is loaded lazily has to be in view."""
    loaded = "images => images.every(image => image.complete && image.naturalWidth > 0)"
    until(lambda: images.evaluate_all(loaded), "the images are loaded")
