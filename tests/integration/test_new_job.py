"""The page "New job" in a real browser, on the real stack."""

import base64
import json
from collections.abc import Iterator
from io import BytesIO
from math import ceil
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, ConsoleMessage, Page, Route, expect

from tests.integration.browser import fresh_page
from tests.integration.conftest import Stack, until
from tests.integration.specs import QUICK
from tests.integration.test_accessibility import AXE, LOOKS, save, serious, watched

pytestmark = pytest.mark.integration

LIGHT = "canvas => [...canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data].join()"
"""The pixels of the preview."""
UNFOLD = "one => { while ((one = one.parentElement.closest('details'))) one.open = true }"
"""Opens the folds around a field."""


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page of a fresh profile. Refused requests are what is tested; any other complaint fails the test."""
    complaints: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        if message.type == "error" and "422" not in message.text:
            complaints.append(message.text)

    with fresh_page(browser, viewport={"width": 1440, "height": 1000}) as page:
        page.on("console", listen)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        yield page
    assert complaints == []


def spec(page: Page) -> Any:
    return json.loads(page.locator("#spec").input_value())


def wait_for_answer(page: Page) -> None:
    expect(page.locator("#preview")).not_to_have_attribute("aria-busy", "true")
    expect(page.locator("#preview-state")).to_contain_text("The network says")


def test_a_job_is_made_with_the_form_beside_its_preview(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    expect(page.locator("#answers tr")).to_have_count(5)
    before = page.locator("#picture").evaluate(LIGHT)

    page.locator("#f-scene\\.objects\\.0\\.mesh").fill("primitive/torus")
    assert spec(page)["scene"]["objects"][0]["mesh"] == "primitive/torus"
    wait_for_answer(page)
    assert page.locator("#picture").evaluate(LIGHT) != before

    steps = page.locator("#f-attack\\.steps")
    steps.fill("many")
    error = page.locator("#f-attack\\.steps-error")
    expect(error).to_contain_text("integer")
    expect(steps).to_have_attribute("aria-invalid", "true")
    page.locator("#submit").click()  # the service refuses it, and the errors are listed
    expect(page.locator("#problems a")).to_have_text("attack.steps")
    steps.fill("2")
    expect(error).to_be_hidden()

    # both ways: what is changed in the JSON is in the fields
    page.locator("#spec").fill(json.dumps(spec(page) | {"seed": 11}))
    expect(page.locator("#f-seed")).to_have_value("11")
    page.locator("#spec").fill(page.locator("#spec").input_value().replace("11", str(2**60 + 1)))
    expect(page.locator("#f-seed")).to_have_value(str(2**60 + 1))
    page.locator("#f-scene\\.objects\\.0\\.mesh").fill("primitive/torus")
    assert spec(page)["seed"] == 2**60 + 1  # a number of JavaScript would be rounded
    page.locator("#f-seed").fill("11")
    page.locator("#f-attack\\.renderer").select_option("pyrender")
    expect(page.locator("#f-attack\\.groups-color")).to_be_visible()
    page.locator("#f-attack\\.groups-color").uncheck()
    assert "color" not in spec(page)["attack"]["groups"]
    wait_for_answer(page)

    page.locator("#plan").click()
    expect(page.locator("#cost")).to_contain_text("Up to 2 steps")
    page.locator("#submit").click()
    page.wait_for_url("**/jobs/*")
    job = stack.client.get(f"/v1/jobs/{page.url.rsplit('/', 1)[1]}").json()
    assert job["seed"] == 11
    assert job["spec"]["scene"]["objects"][0]["mesh"] == "primitive/torus"
    assert (job["renderer"], job["spec"]["attack"]["steps"]) == ("pyrender", 2)

    page.goto(f"{stack.client.base_url}/new?from={job['id']}")
    expect(page.locator("#f-attack\\.steps")).to_have_value("2")
    assert spec(page) == job["spec"]


def noise(height: int, width: int) -> bytes:
    buffer = BytesIO()
    texels = np.random.default_rng(8).integers(0, 256, (height, width, 3), np.uint8)
    Image.fromarray(texels).save(buffer, "PNG")
    return buffer.getvalue()


def another_picture(page: Page, *before: str) -> str:
    """What the preview shows once it is none of these. Right after a change it still has its earlier answer."""
    found: list[str] = []

    def differs() -> bool:
        found.append(page.locator("#picture").evaluate(LIGHT))
        return found[-1] not in before

    until(differs, "another picture")
    return found[-1]


def test_a_picture_is_chosen_as_background(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    plain = page.locator("#picture").evaluate(LIGHT)
    box = page.locator("#f-scene\\.background-has")
    box.evaluate(UNFOLD)
    box.check()
    chooser = page.locator("#f-scene\\.background\\.image")
    chooser.evaluate(UNFOLD)
    state = page.locator("#f-scene\\.background\\.image-state")
    chooser.set_input_files({"name": "a.png", "mimeType": "image/png", "buffer": b"no picture"})
    expect(state).to_contain_text("it is no PNG, JPEG or WebP file")
    assert "image" not in spec(page)["scene"]["background"]

    exact = noise(224, 224)
    chooser.set_input_files({"name": "a.png", "mimeType": "image/png", "buffer": exact})
    expect(state).to_contain_text(f"{ceil(len(exact) / 1000)} kB")
    assert base64.b64decode(spec(page)["scene"]["background"]["image"]) == exact
    shown = another_picture(page, plain)

    page.locator("#f-scene\\.background\\.image").set_input_files(
        {"name": "large.png", "mimeType": "image/png", "buffer": noise(500, 900)}
    )
    expect(state).not_to_contain_text(f"{ceil(len(exact) / 1000)} kB")
    with Image.open(BytesIO(base64.b64decode(spec(page)["scene"]["background"]["image"]))) as fitted:
        assert fitted.size == (224, 224)
    another_picture(page, plain, shown)
    page.get_by_role("button", name="Remove the picture").click()
    assert "image" not in spec(page)["scene"]["background"]
    expect(state).to_contain_text("No picture")


def test_the_preview_stays_in_sight_on_a_low_screen(stack: Stack, page: Page) -> None:
    page.set_viewport_size({"width": 1440, "height": 600})
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    page.locator("#f-attack\\.renderer").scroll_into_view_if_needed()  # far from both ends of the page
    page.locator("#preview").hover()
    page.mouse.wheel(0, 2000)
    expect(page.locator("#plan")).to_be_in_viewport(ratio=1)
    page.locator("#plan").click()
    expect(page.locator("#cost li").last).to_be_in_viewport(ratio=0.9)


def test_without_a_script_the_json_is_a_form(stack: Stack, browser: Browser) -> None:
    with fresh_page(browser, java_script_enabled=False) as page:
        page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
        page.locator("#spec").fill("{}")
        page.locator("#submit").click()
        expect(page.locator("#problems")).to_contain_text("scene")
        page.locator("#spec").fill('{"scene": {"objects": [{"mesh": "primitive/sphere"}]}, "attack": {"steps": 1}}')
        page.locator("#submit").click()
        page.wait_for_url("**/jobs/*")


@pytest.mark.parametrize(("theme", "width"), LOOKS)
def test_the_whole_form_is_accessible(stack: Stack, browser: Browser, theme: Any, width: int) -> None:
    """With its preview, every fold open, a list of errors, and messages at fields of all kinds."""
    with fresh_page(browser, color_scheme=theme, viewport={"width": width, "height": 900}) as page:
        complaints = watched(page, str(stack.client.base_url))
        page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
        wait_for_answer(page)
        save(page, f"new-preview-{theme}-{width}.png")
        for field in ("scene.objects.0.scale", "seed", "scene.camera.size.0", "attack.steps"):
            page.locator(f"[id='f-{field}']").evaluate(UNFOLD)
            page.locator(f"[id='f-{field}']").fill("-1")
        page.locator("#submit").click()
        expect(page.locator("#problems a")).to_have_count(4)
        for field in ("scene.objects.0.scale", "seed", "scene.camera.size", "attack.steps"):
            expect(page.locator(f"[id='f-{field}-error']")).not_to_be_empty()
        page.locator("#f-scene\\.background-has").evaluate(UNFOLD)
        page.locator("#f-scene\\.background-has").check()
        page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        save(page, f"new-errors-{theme}-{width}.png")
        page.evaluate(AXE)
        assert serious(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), "it scrolls sideways"
        assert [one for one in complaints if "422" not in one] == []


@pytest.mark.parametrize("which", ["beside the fields", "beside the preview"])
def test_a_pressed_button_says_at_once_that_the_request_is_checked(stack: Stack, page: Page, which: str) -> None:
    page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
    wait_for_answer(page)
    held: list[Route] = []
    page.route("**/v1/jobs", lambda route: held.append(route))
    buttons = page.get_by_role("button", name="Submit the job")
    pressed = buttons.nth(0 if which == "beside the fields" else 1)
    place = "#submit" if which == "beside the fields" else "#preview [type=submit]"
    pressed.click()
    expect(page.locator(place)).to_have_text("Checking…")
    expect(page.locator("#submitting")).to_have_text("Checking…")
    expect(page.locator("[type=submit][form=new], #submit").and_(page.locator(":disabled"))).to_have_count(2)
    held[0].fulfill(status=422, json={"detail": "no", "errors": [{"field": "seed", "detail": "no"}]})
    expect(page.locator("#problems")).to_contain_text("seed")
    expect(buttons).to_have_count(2)
    expect(page.locator("#submitting")).to_be_empty()


def test_a_form_of_the_service_s_own_waits_too_and_works_without_a_script(stack: Stack, browser: Browser) -> None:
    """The page of a finished job, whose request is tried again: first with the script, and then without."""
    job = stack.ended(stack.submit(QUICK))
    with fresh_page(browser) as page:
        page.goto(f"{stack.client.base_url}/jobs/{job['id']}")
        page.route("**/retry", lambda route: route.fulfill(status=204))  # so that the browser stays on the page
        page.get_by_role("button", name="Retry").click()
        expect(page.locator("#retry")).to_have_text("Checking…")
        expect(page.locator("#retry")).to_be_disabled()
        expect(page.locator("#submitting")).to_have_text("Checking…")
        page.unroute("**/retry")
        page.reload()
        page.get_by_role("button", name="Retry").click()
        page.wait_for_url(lambda url: job["id"] not in url)
    with fresh_page(browser, java_script_enabled=False) as page:
        page.goto(f"{stack.client.base_url}/new?mesh=primitive/sphere")
        assert "Checking it takes a few seconds" in page.content()  # text of `noscript` is none to the driver
        page.get_by_role("button", name="Submit the job").click()
        page.wait_for_url("**/jobs/*")
