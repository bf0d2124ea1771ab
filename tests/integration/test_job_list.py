"""The list of 5,000 jobs in a real browser: queries, sorting, ticks and focus during live changes, keys."""

import re
from collections.abc import Iterator

import httpx
import pytest
from fastapi import FastAPI
from playwright.sync_api import Browser, ConsoleMessage, Page, expect

from benchmarks.filled_record import fill
from scene_attack_api.main import create_app
from scene_attack_api.requests import Services
from scene_attack_service.settings import Settings
from tests.integration.browser import fresh_page
from tests.unit.api.conftest import serving

pytestmark = pytest.mark.integration
JOBS = 5000


@pytest.fixture(scope="module")
def app(redis_url: str, tmp_path_factory: pytest.TempPathFactory) -> FastAPI:
    settings = Settings(data=tmp_path_factory.mktemp("data"), redis_url=redis_url)
    app = create_app(settings)
    app.state.settings = settings
    return app


@pytest.fixture(scope="module")
def client(app: FastAPI) -> Iterator[httpx.Client]:
    """The service with 5,000 jobs in its record, and no worker."""
    with serving(app) as client:
        fill(app.state.settings, JOBS)
        yield client


@pytest.fixture
def services(app: FastAPI, client: httpx.Client) -> Services:  # noqa: ARG001 - it starts the app
    found: Services = app.state.services
    return found


@pytest.fixture
def page(browser: Browser, client: httpx.Client) -> Iterator[Page]:
    complaints: list[str] = []

    def listen(message: ConsoleMessage) -> None:
        if message.type != "log" and "404" not in message.text:  # the jobs of this test have no files
            complaints.append(message.text)

    with fresh_page(browser, base_url=str(client.base_url), viewport={"width": 1440, "height": 900}) as page:
        page.on("console", listen)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        yield page
    assert complaints == []


def test_five_thousand_jobs_are_filtered_and_sorted(page: Page) -> None:
    page.goto("/")
    expect(page.locator(".totals")).to_contain_text(f"{JOBS:,} jobs")
    page.get_by_label("Query").fill("renderer:torch verified p<5e-3")
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(r"\?q=renderer%3Atorch\+verified\+p%3C5e-3$"))
    page.get_by_role("link", name="Queries").click()
    expect(page.locator("th[aria-sort]")).to_contain_text("Queries")
    shown = page.locator("#rows .c-queries").all_text_contents()
    numbers = [int(text.replace(",", "")) for text in shown]
    assert len(numbers) == 50
    assert numbers == sorted(numbers)
    first = str(page.locator("#rows tr").first.get_attribute("data-id"))
    page.get_by_role("link", name="Next jobs").click()
    expect(page.locator("#rows tr").first).not_to_have_attribute("data-id", first)
    assert int(page.locator("#rows .c-queries").first.inner_text().replace(",", "")) >= numbers[-1]
    page.get_by_role("link", name="Previous jobs").click()
    expect(page.locator("#rows tr").first).to_have_attribute("data-id", first)


def test_ticks_and_focus_survive_live_changes(page: Page, services: Services) -> None:
    page.goto("/?q=state:queued")
    row = page.locator("#rows tr").nth(1)
    job = str(row.get_attribute("data-id"))
    row.get_by_role("checkbox").check()
    row.locator(".c-name a").first.focus()
    page.evaluate("window.kept = document.activeElement")
    attempt = services.record.leases.lease(str(page.locator("#rows tr").first.get_attribute("data-id")), "test", 600)
    assert attempt is not None
    expect(page.locator("#rows tr").first).to_have_attribute("data-id", job)  # the leased one is queued no more
    assert services.record.leases.lease(job, "test", 600) is not None
    page.locator(".strip dd").first.filter(has_text="2").wait_for()
    expect(
        page.locator(f'tr[data-id="{job}"] input')
    ).to_be_checked()  # ticked: it stays, though it meets the query no more
    assert page.evaluate("window.kept === document.activeElement && window.kept.isConnected")


def test_keys(page: Page) -> None:
    page.goto("/")
    rows = page.locator("#rows tr")
    page.keyboard.press("j")
    page.keyboard.press("x")
    page.keyboard.press("j")
    page.keyboard.press("x")
    expect(page.locator("#ticked")).to_have_text("2 ticked")
    ids = [rows.nth(k).get_attribute("data-id") for k in (0, 1)]
    page.keyboard.press("k")
    expect(rows.first.locator(".c-name a").first).to_be_focused()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("c")
    expect(page.locator("h1")).to_have_text("Compare 2 jobs")
    assert all(str(one) in page.url for one in ids)
    page.goto("/")
    page.keyboard.press("/")
    expect(page.get_by_label("Query")).to_be_focused()


def test_ticked_jobs_are_tagged_without_a_reload(page: Page) -> None:
    page.goto("/?q=state:failed")
    page.evaluate("window.here = true")
    page.locator("#rows input").nth(2).check()
    page.get_by_label("Tag", exact=True).fill("mine")
    page.get_by_role("button", name="Add tag").click()
    expect(page.locator("#rows tr").nth(2).locator(".tag")).to_have_text("mine")
    assert page.evaluate("window.here")


def test_ticked_jobs_are_retried_and_deleted_without_a_reload(page: Page, client: httpx.Client) -> None:
    page.goto("/?q=state:failed+-tag:mine&sort=created")
    page.evaluate("window.here = true")
    rows = page.locator("#rows tr")
    first, second = (str(rows.nth(k).get_attribute("data-id")) for k in (0, 1))
    rows.nth(0).get_by_role("checkbox").check()
    page.get_by_role("button", name="Retry").click()
    expect(page.locator("#said")).to_have_text("Retry: done")
    [retry] = [job for job in client.get("/v1/jobs", params={"limit": 1}).json()["items"] if job["retry_of"] == first]
    rows.nth(1).get_by_role("checkbox").check()
    expect(page.locator("#ticked")).to_have_text("1 ticked")  # what was retried is ticked no more
    page.once("dialog", lambda dialog: dialog.accept())
    page.get_by_role("button", name="Delete").click()
    expect(page.locator(f'tr[data-id="{second}"]')).to_have_count(0)
    assert client.get(f"/v1/jobs/{second}").status_code == httpx.codes.NOT_FOUND
    assert page.evaluate("window.here")
    page.goto(f"/jobs/{retry['id']}")
    page.get_by_role("link", name=f"job {first[:8]}").click()
    expect(page).to_have_url(re.compile(f"/jobs/{first}$"))
    page.get_by_role("button", name="Retry").click()
    expect(page).to_have_url(re.compile(f"/jobs/(?!{first})"))
    expect(page.get_by_text("Repeats")).to_be_visible()


def test_without_javascript(browser: Browser, client: httpx.Client) -> None:
    with fresh_page(browser, base_url=str(client.base_url), java_script_enabled=False) as page:
        page.goto("/?q=state:queued")
        rows = page.locator("#rows tr")
        job = str(rows.first.get_attribute("data-id"))
        rows.first.get_by_role("checkbox").check()
        page.get_by_label("Tag", exact=True).fill("plain")
        page.get_by_role("button", name="Add tag").click()
        expect(page).to_have_url(re.compile(r"\?q=state%3Aqueued$"))
        rows.first.get_by_role("link", name="plain").click()
        expect(rows).to_have_count(1)
        rows.first.locator(".c-name a").first.click()
        page.get_by_text("Title, tags and note").click()
        page.get_by_label("Title").fill("Mine")
        page.get_by_role("button", name="Save").click()
        expect(page.locator("h1")).to_have_text("Mine")
        assert page.url.endswith(f"/jobs/{job}")


def test_chosen_columns_are_kept(page: Page) -> None:
    page.goto("/")
    expect(page.locator("#rows .c-method").first).to_be_hidden()
    page.get_by_text("Columns", exact=True).click()
    page.get_by_role("checkbox", name="Method").check()
    expect(page.locator("#rows .c-method").first).to_be_visible()
    page.reload()
    expect(page.locator("#rows .c-method").first).to_be_visible()


LONG = {"c-seconds": "13 min 36 s", "c-p": "166.45 (166.48\u00a0as\u00a0saved)", "c-created": "59 min ago"}
"""Texts of the widest cells, those of jobs that attack poses."""


def test_the_usual_columns_fit(page: Page) -> None:
    page.goto("/?q=state:succeeded")
    page.locator("#rows tr").first.wait_for()
    for column, text in LONG.items():
        page.locator(f"#rows .{column}").first.evaluate("(cell, text) => { cell.textContent = text }", text)
    verdicts = '<span class="badge changed">changed</span> <span class="badge unverified">not verified</span>'
    page.locator("#rows .c-outcome").first.evaluate("(cell, text) => { cell.innerHTML = text }", verdicts)
    width, room = page.locator("main .scroll").evaluate("one => [one.scrollWidth, one.clientWidth]")
    assert width <= room


def test_cards_on_a_phone(page: Page) -> None:
    page.set_viewport_size({"width": 390, "height": 800})
    page.goto("/")
    assert page.evaluate("document.documentElement.scrollWidth <= 390")
    box = page.locator("#rows tr").first.bounding_box()
    assert box is not None
    assert box["height"] > 100
