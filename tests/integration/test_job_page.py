"""The page of one job in a real browser, on the real stack: viewer, copy buttons, and what updates leave alone."""

from collections.abc import Iterator
from io import BytesIO
from typing import Any

import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from scene_attack.attacks.run import saved_step
from tests.integration.browser import fresh_page, wait_for_images
from tests.integration.conftest import Stack, until
from tests.integration.specs import ENDLESS, GROUPS, QUICK

pytestmark = pytest.mark.integration

COLOURS = """([[x, y], ...more]) => {
  const canvas = document.querySelector('before-after canvas');
  const ratio = window.devicePixelRatio;
  const copy = Object.assign(document.createElement('canvas'), { width: canvas.width, height: canvas.height });
  const context = copy.getContext('2d', { willReadFrequently: true });
  context.drawImage(canvas, 0, 0);
  return [[x, y], ...more].map(([x, y]) => [...context.getImageData(x * ratio, y * ratio, 1, 1).data.slice(0, 3)]);
}"""
"""The colours that the viewer shows at points of its canvas, in CSS pixels from its corner."""


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page that may use the clipboard; whatever the browser complains about fails the test."""
    complaints: list[str] = []
    allowed = ["clipboard-read", "clipboard-write"]
    with fresh_page(browser, permissions=allowed, viewport={"width": 1000, "height": 1000}) as page:
        page.on("console", lambda message: complaints.append(message.text) if message.type != "log" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        yield page
    assert complaints == []


@pytest.fixture(scope="module")
def job(stack: Stack) -> dict[str, Any]:
    """A job of 64×64 pixels that has ended."""
    return stack.ended(stack.submit(QUICK))


def image(stack: Stack, job: dict[str, Any], name: str) -> Image.Image:
    data = stack.client.get(f"/v1/jobs/{job['id']}/artifacts/{name}.png").content
    return Image.open(BytesIO(data)).convert("RGB")


def opened(stack: Stack, page: Page, job: dict[str, Any]) -> None:
    page.goto(f"{stack.client.base_url}/jobs/{job['id']}")
    expect(page.locator("before-after canvas")).to_have_attribute("data-scale", "10.5")  # 672 screen pixels for 64


def test_the_viewer_shows_the_pixels_of_both_files(stack: Stack, page: Page, job: dict[str, Any]) -> None:
    before, after = image(stack, job, "original"), image(stack, job, "attacked")
    opened(stack, page, job)
    width = page.locator("before-after canvas").evaluate("canvas => canvas.clientWidth")
    pixels = [(20, 32), (30, 40), (36, 20), (44, 33)]
    points = [[(width - 672) / 2 + 10.5 * (x + 0.5), 10.5 * (y + 0.5)] for x, y in pixels]
    old = [list(before.getpixel(one)) for one in pixels]  # type: ignore[call-overload]
    new = [list(after.getpixel(one)) for one in pixels]  # type: ignore[call-overload]
    assert old != new
    assert page.evaluate(COLOURS, points) == [*old[:2], *new[2:]]  # the divider is in the middle
    page.get_by_role("radio", name="Original").check()
    assert page.evaluate(COLOURS, points) == old
    page.locator("before-after canvas").focus()
    page.keyboard.press("f")
    expect(page.get_by_role("radio", name="Attacked")).to_be_checked()
    assert page.evaluate(COLOURS, points) == new
    page.get_by_label("Difference ×").fill("20")
    expect(page.get_by_role("radio", name="Difference")).to_be_checked()
    strong = [
        [min(255, max(0, 128 + 20 * (b - a))) for a, b in zip(*pair, strict=True)]
        for pair in zip(old, new, strict=True)
    ]
    assert page.evaluate(COLOURS, points) == strong
    page.get_by_role("radio", name="Slide").check()
    page.get_by_label("Divider").fill("100")
    assert page.evaluate(COLOURS, points) == old


def test_the_viewer_zooms_down_to_the_values_of_a_pixel(stack: Stack, page: Page, job: dict[str, Any]) -> None:
    before, after = image(stack, job, "original"), image(stack, job, "attacked")
    opened(stack, page, job)
    canvas = page.locator("before-after canvas")
    canvas.focus()
    for _ in range(3):
        page.keyboard.press("+")
    expect(canvas).to_have_attribute("data-scale", "64")
    canvas.hover(position={"x": 301, "y": 305})
    shown = page.locator("before-after .readout").inner_text()
    place, _, values = shown.partition(": ")
    x, y = (int(part.split()[1]) for part in place.split(", "))
    assert 20 < x < 44
    assert 20 < y < 44
    words = [" ".join(map(str, one.getpixel((x, y)))) for one in (before, after)]  # type: ignore[arg-type]
    assert values.startswith(f"{words[0]} → {words[1]} (")
    page.get_by_role("radio", name="Side by side").check()
    half = canvas.evaluate("canvas => canvas.clientWidth") / 2
    canvas.hover(position={"x": 100, "y": 305})
    left = page.locator("before-after .readout").inner_text()
    canvas.hover(position={"x": 100 + half, "y": 305})
    assert page.locator("before-after .readout").inner_text() == left  # both panes show the same part
    page.get_by_role("button", name="Fit the whole image").click()
    assert float(canvas.get_attribute("data-scale") or 0) < 10


def test_a_zoom_leaves_the_point_under_the_pointer(stack: Stack, page: Page, job: dict[str, Any]) -> None:
    opened(stack, page, job)
    moved = page.evaluate("""async () => {
      const { fitted, zoomedAt } = await import('/static/viewer_geometry.js');
      const image = { width: 64, height: 48 };
      let state = { scale: null, left: 0, top: 0 };
      const at = [];
      for (const factor of [3, 1.7, 0.9, 2]) {
        const pane = fitted(image, 500, 400, state);
        const before = [(260 - pane.x) / pane.scale, (150 - pane.y) / pane.scale];
        state = zoomedAt(pane, 260, 150, factor, 1000);
        const next = fitted(image, 500, 400, state);
        at.push((260 - next.x) / next.scale - before[0], (150 - next.y) / next.scale - before[1]);
      }
      return at;
    }""")
    assert moved == pytest.approx([0.0] * 8, abs=1e-9)


def test_an_update_leaves_viewer_focus_scroll_and_open_parts(stack: Stack, page: Page, job: dict[str, Any]) -> None:
    page.route(
        f"**/parts/jobs/{job['id']}",
        lambda route: route.fulfill(response=(answer := route.fetch()), body=changed(answer.text())),
    )
    opened(stack, page, job)
    page.get_by_role("radio", name="Difference").check()
    page.locator("before-after canvas").focus()
    page.keyboard.press("+")
    scale = page.locator("before-after canvas").get_attribute("data-scale")
    page.locator("#plan-details > summary").click()
    page.get_by_role("radio", name="seconds").focus()
    page.evaluate("window.scrollBy({ top: 200, behavior: 'instant' })")
    before = page.evaluate("[window.scrollY, window.kept = document.querySelector('before-after canvas')][0]")
    page.evaluate("update()")
    expect(page.locator("h1")).to_have_text("another name")
    expect(page.locator("#new")).to_be_visible()
    assert page.evaluate("window.kept.isConnected && window.kept === document.querySelector('before-after canvas')")
    assert page.evaluate("document.activeElement.id") == "against-seconds"
    assert page.evaluate("window.scrollY") == before
    assert page.get_by_role("radio", name="Difference").is_checked()
    assert page.locator("before-after canvas").get_attribute("data-scale") == scale
    assert page.locator("#plan-details").get_attribute("open") is not None
    expect(page.locator("#files")).to_have_count(0)  # what the new part lacks is gone


def changed(part: str) -> str:
    """A job's part with another heading, something new behind the viewer, and without its files."""
    assert '<h2 id="files">' in part
    part = part.replace("<h1>sphere", "<h1>another name").replace('<h2 id="files">Files', "<h2>Files")
    return part.replace('<section class="curves"', '<p id="new">new</p><section class="curves"')


def test_buttons_copy_the_id_and_the_request(stack: Stack, page: Page, job: dict[str, Any]) -> None:
    opened(stack, page, job)
    expect(page.locator(".id code")).to_have_text(job["id"][:8])
    page.get_by_role("button", name="Copy id").click()
    expect(page.locator("#copied")).to_have_text("Copied the job’s id")
    assert page.evaluate("navigator.clipboard.readText()") == job["id"]
    page.locator("#spec-details > summary").click()
    page.locator("#spec-details button").click()
    expect(page.locator("#copied")).to_have_text("Copied the request")
    copied = page.evaluate("navigator.clipboard.readText().then(JSON.parse)")
    assert copied == job["spec"]


def test_without_script_the_images_stand_side_by_side(stack: Stack, browser: Browser, job: dict[str, Any]) -> None:
    with fresh_page(browser, java_script_enabled=False, viewport={"width": 1440, "height": 900}) as page:
        page.goto(f"{stack.client.base_url}/jobs/{job['id']}")
        images = page.locator(".images img")
        expect(images).to_have_count(3)
        wait_for_images(images)
        boxes = [one.bounding_box() for one in images.all()]
        assert len({box["y"] for box in boxes if box is not None}) == 1
        expect(page.locator(".viewer")).to_be_hidden()
        expect(page.locator("button[data-copy]").first).to_be_hidden()
        page.locator("#provenance-details > summary").click()
        expect(page.locator("#provenance-details dl")).to_be_visible()


def test_the_commands_are_copied(stack: Stack, page: Page, job: dict[str, Any]) -> None:
    opened(stack, page, job)
    page.locator("#again-details > summary").click()
    for name, begins in (("Command line", "SCENE_ATTACK_URL="), ("curl", "curl -s http"), ("Python", "import json")):
        page.get_by_role("button", name=f"Copy as {name}").click()
        expect(page.locator("#copied")).to_have_text(f"Copied it for {name}")
        assert page.evaluate("navigator.clipboard.readText()").startswith(begins)


def test_the_changes_of_several_groups_in_words_images_and_a_plot(stack: Stack, page: Page) -> None:
    job = stack.ended(stack.submit(GROUPS))
    assert job["state"] == "succeeded", job["failure"]
    page.goto(f"{stack.client.base_url}/jobs/{job['id']}")
    for change in job["result"]["change"]["things"]:
        said = page.locator(".changed-words li").filter(has_text=change["subject"])
        expect(said).to_have_text(f"{change['subject']} {change['sentence']}")
    images = page.locator(".changed-images img")
    expect(images).to_have_count(4)  # tilt; map before, after and their ratio
    wait_for_images(images)
    expect(page.locator(".polar svg")).to_have_count(3)
    plot = page.locator(".upset svg")
    expect(plot.locator(".bar")).to_have_count(8)
    addresses = plot.locator("image").evaluate_all("images => images.map(image => image.getAttribute('href'))")
    assert len(addresses) == 8
    for address, groups in zip(addresses, (one["groups"] for one in job["result"]["subsets"]), strict=True):
        assert stack.client.get(address).headers["content-type"] == "image/png", groups
    heights = plot.locator(".bar").evaluate_all("bars => bars.map(bar => Number(bar.getAttribute('height')))")
    shares = [one["goal_probability"] for one in job["result"]["subsets"]]
    assert [height / 90 for height in heights] == pytest.approx(shares, abs=0.001)
    expect(page.get_by_role("table", name="The stored perturbation").locator("tbody tr")).to_have_count(8)
    page.locator("#changed-values > summary").click()
    rows = page.get_by_role("table", name="The numbers of the scene that were changed").locator("tbody tr")
    expect(rows).to_have_count(sum(len(one["values"]) for one in job["result"]["change"]["things"]))


def test_a_cancelled_job_shows_its_best_so_far_and_another_goes_on_from_there(stack: Stack, page: Page) -> None:
    job_id = stack.submit(ENDLESS)
    until(lambda: saved_step(stack.data / "checkpoints" / job_id) > 1, "a checkpoint")
    stack.client.post(f"/v1/jobs/{job_id}/cancel")
    assert stack.ended(job_id)["state"] == "cancelled"
    page.goto(f"{stack.client.base_url}/jobs/{job_id}")
    expect(page.get_by_role("heading", name="The best so far")).to_be_visible()
    expect(page.locator("before-after canvas")).to_be_visible()
    page.get_by_role("button", name="Continue from its checkpoint").click()
    page.wait_for_url(lambda url: "/jobs/" in url and job_id not in url)
    later = page.url.rpartition("/")[2]
    best = stack.client.get(f"/v1/jobs/{job_id}/artifacts/best-so-far.json").json()
    went_on = stack.attacking(later)
    stack.client.post(f"/v1/jobs/{later}/cancel")
    assert went_on["retry_of"] == job_id
    assert went_on["progress"]["step"] >= best["steps"] > 0
    stack.ended(later)
