"""The view of a scene in three dimensions in a real browser with a software WebGL, and what it shows."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect

from tests.integration.browser import fresh_page
from tests.integration.conftest import Stack

SOFTWARE = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
READ_BACK = "GPU stall due to ReadPixels"
"""What the software driver says whenever the browser without a GPU puts a drawing onto the screen."""
GROUND = (51, 102, 153)
"""The displayed colour behind the objects of the jobs here."""


@contextmanager
def looking(browser: Browser, stack: Stack, **context: Any) -> Iterator[Page]:
    """A page whose browser writes nothing of its own into its console, and asks nobody but the service."""
    said: list[str] = []
    asked: list[str] = []
    with fresh_page(browser, **context) as page:
        page.on("console", lambda message: None if READ_BACK in message.text else said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        yield page
    assert said == []
    assert [url for url in asked if not url.startswith(str(stack.client.base_url))] == []


def opened(page: Page, stack: Stack, job: str) -> None:
    """The page of a job with its scene drawn once."""
    page.goto(f"{stack.client.base_url}/jobs/{job}")
    page.locator("#scene3d-details > summary").click()
    expect(page.locator("scene-3d")).to_have_attribute("data-drawings", "1")
    expect(page.locator("scene-3d [role=status]")).to_contain_text("arrow keys")


def drawn_after(page: Page, act: Callable[[], Any]) -> np.ndarray:
    """The view once it has been drawn again after `act`; int [h, w, 3], without the ring of the focus."""
    view = page.locator("scene-3d")
    drawings = str(view.get_attribute("data-drawings"))
    act()
    expect(view).not_to_have_attribute("data-drawings", drawings)
    image = np.asarray(Image.open(BytesIO(view.locator("canvas").screenshot())).convert("RGB"))
    return image[8:-8, 8:-8].astype(int)


def radio(page: Page, name: str) -> Locator:
    return page.locator("scene-3d").get_by_role("radio", name=name)


def framed(page: Page, size: tuple[int, int]) -> np.ndarray:
    """The part of the view that an image of this height and width shows, averaged to its pixels: int [h, w, 3]."""
    whole = Image.open(BytesIO(page.locator("scene-3d canvas").screenshot())).convert("RGB")
    scale = min(whole.height / size[0], whole.width / size[1])
    high, wide = scale * size[0], scale * size[1]
    left, top = (whole.width - wide) / 2, (whole.height - high) / 2
    box = (left, top, left + wide, top + high)
    return np.asarray(whole.resize(size[::-1], Image.Resampling.BOX, box)).astype(int)


def stored(stack: Stack, job: str, name: str) -> np.ndarray:
    """An image of a job, int [h, w, 3]."""
    data = stack.client.get(f"/v1/jobs/{job}/artifacts/{name}.png").content
    return np.asarray(Image.open(BytesIO(data)).convert("RGB")).astype(int)


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of what differs from the ground. The rim of a view may have a line of the page."""
    first, second = ((np.abs(image - GROUND).max(axis=-1) > 12)[1:-1, 1:-1] for image in (one, other))
    assert first.any()
    assert second.any()
    return float((first & second).sum() / (first | second).sum())


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """The share of pixels that differ clearly."""
    return float((np.abs(one - other).max(axis=-1) > 30).mean())
