"""The dashboard in a real browser, on the real stack."""

from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.integration.browser import fresh_page, job_state, wait_for_images
from tests.integration.conftest import Stack
from tests.integration.specs import ENDLESS, QUICK

pytestmark = pytest.mark.integration

ASKED: dict[str, Any] = {
    "scene": {"source": {"format": "clevr", "generate": {"seed": 8, "index": 2, "objects": 4}}},
    "target": {
        "name": "iep",
        "ask": {
            "question": [
                {"function": "scene"},
                {"function": "filter_color", "inputs": [0], "value_inputs": ["red"]},
                {"function": "scene"},
                {"function": "filter_material", "inputs": [2], "value_inputs": ["metal"]},
                {"function": "union", "inputs": [1, 3]},
                {"function": "count", "inputs": [4]},
            ]
        },
    },
    "attack": {"renderer": "image", "base_renderer": "pyrender", "steps": 2},
}

COVERED = """panes => panes.every(pane => {
  const [image, mask] = [...pane.querySelectorAll('img')].map(one => one.getBoundingClientRect());
  return image.width > 50 && ['x', 'y', 'width', 'height'].every(side => Math.abs(image[side] - mask[side]) < 1);
})"""
"""Whether each mask lies on the whole of its image."""


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page of a fresh profile; whatever the browser complains about fails the test."""
    complaints: list[str] = []
    with fresh_page(browser) as page:
        page.on("console", lambda message: complaints.append(message.text) if message.type != "log" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        yield page
    assert complaints == []


@pytest.fixture
def endless(stack: Stack) -> Iterator[str]:
    """A job that runs until it is cancelled; at the latest after the test."""
    job_id = stack.submit(ENDLESS)
    yield job_id
    stack.client.post(f"/v1/jobs/{job_id}/cancel")
    stack.ended(job_id)


def test_list_and_job_page_of_a_finished_job(stack: Stack, page: Page) -> None:
    job = stack.ended(stack.submit(QUICK))
    page.goto(f"{stack.client.base_url}/")
    row = page.locator("tbody tr", has=page.locator(f'a[href="/jobs/{job["id"]}"]'))
    expect(row.locator(".badge").first).to_have_text("succeeded")
    row.scroll_into_view_if_needed()
    expect(row.locator("img")).to_have_count(2)
    row.locator("a").click()
    expect(page.locator("h1")).to_have_text("sphere")
    images = page.locator(".images img")
    expect(images).to_have_count(3)
    wait_for_images(images)
    expect(page.get_by_role("img", name="Log-probability advantage").first).to_be_visible()
    curves = page.locator(".charts.by-step svg")
    expect(curves).to_have_count(4)
    expect(page.locator(".by-queries").first).to_be_hidden()
    assert curves.evaluate_all("svgs => svgs.every(svg => svg.querySelector('.curve').getTotalLength() > 0)")
    expect(page.locator(".by-seconds").first).to_be_hidden()
    page.get_by_role("radio", name="seconds").check()
    expect(page.locator(".by-step").first).to_be_hidden()
    expect(page.locator(".by-seconds").first).to_be_visible()
    page.get_by_role("radio", name="queries").check()
    expect(page.locator(".by-seconds").first).to_be_hidden()
    expect(page.locator(".by-queries").first).to_be_visible()
    expect(page.get_by_role("table", name="The stored perturbation")).to_have_count(0)  # of a single group
    expect(page.get_by_role("heading", name="Provenance")).to_be_visible()


def test_a_running_job_moves_and_can_be_cancelled_from_its_page(stack: Stack, page: Page, endless: str) -> None:
    job_id = endless
    page.goto(f"{stack.client.base_url}/jobs/{job_id}")
    expect(job_state(page)).to_have_text("running")
    progress = page.locator("#live progress")
    expect(progress).to_be_visible()
    page.locator("#copy-id").focus()
    page.evaluate("getSelection().selectAllChildren(document.querySelector('h1'))")
    page.evaluate("window.kept = document.activeElement, window.chosen = getSelection().toString()")
    before = progress.evaluate("bar => bar.value")
    page.wait_for_function("before => document.querySelector('#live progress')?.value > before", arg=before)
    assert page.evaluate("kept.id === 'copy-id' && kept.isConnected && document.activeElement === kept")
    assert page.evaluate("chosen !== '' && getSelection().toString() === chosen")
    page.get_by_role("radio", name="seconds").check()
    now = page.locator("#live progress").evaluate("bar => bar.value")
    page.wait_for_function("now => document.querySelector('#live progress')?.value > now", arg=now)
    assert page.get_by_role("radio", name="seconds").is_checked()  # what the reader chose outlives an update
    page.get_by_role("button", name="Cancel this job").click()
    expect(job_state(page)).to_have_text("cancelled")
    assert stack.ended(job_id)["state"] == "cancelled"


def test_the_list_moves_by_itself(stack: Stack, page: Page) -> None:
    page.goto(f"{stack.client.base_url}/")
    job_id = stack.submit(QUICK)
    row = page.locator("tbody tr", has=page.locator(f'a[href="/jobs/{job_id}"]'))
    expect(row.locator(".badge").first).to_have_text("succeeded")


def test_a_question_s_page_shows_what_its_functions_attend_to(stack: Stack, page: Page) -> None:
    """All masks are there, and each covers the image that it is of."""
    job = stack.ended(stack.submit(ASKED))
    assert job["state"] == "succeeded", job["failure"]
    page.goto(f"{stack.client.base_url}/")
    name = "A program of 6 functions that asks for a number"
    page.locator(f'a[href="/jobs/{job["id"]}"]', has_text=name).click()
    expect(page.locator("h1")).to_have_text(name)
    expect(page.locator(".step")).to_have_count(6)
    panes = page.locator(".attended")
    expect(panes).to_have_count(2 * 5)
    for pane in panes.all():
        pane.scroll_into_view_if_needed()  # images are loaded when they come into view
    wait_for_images(page.locator(".attended img"))
    assert panes.evaluate_all(COVERED)
    joined, first = page.locator(".step").last.bounding_box(), page.locator(".step").first.bounding_box()
    assert joined is not None
    assert first is not None
    assert joined["y"] > first["y"] + first["height"]  # what takes both chains stands below them
    page.set_viewport_size({"width": 360, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    summary = page.get_by_text("Its program, and what each function attends to")
    summary.focus()
    page.keyboard.press("Enter")
    expect(panes.first).to_be_hidden()
    page.keyboard.press("Enter")
    expect(panes.first).to_be_visible()


def test_pages_work_without_script(stack: Stack, browser: Browser, endless: str) -> None:
    job_id = endless
    stack.attacking(job_id)
    with fresh_page(browser, java_script_enabled=False) as page:
        page.goto(f"{stack.client.base_url}/jobs/{job_id}")
        with page.expect_navigation():  # the form's answer is the page again; a reload must not run into it
            page.get_by_role("button", name="Cancel this job").click()
        stack.ended(job_id)
        page.goto(f"{stack.client.base_url}/jobs/{job_id}")
        expect(job_state(page)).to_have_text("cancelled")
