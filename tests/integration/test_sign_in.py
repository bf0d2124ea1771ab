"""The dashboard of a service that has keys, in a real browser, and a page of another site that tries to use it."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from playwright.sync_api import Browser, Page, expect

from scene_attack_service.access.caller import Scope
from scene_attack_service.access.keys import AccessKeys
from scene_attack_service.jobs.database import connect, migrate
from scene_attack_service.settings import Settings
from tests.integration.browser import fresh_page, job_state
from tests.integration.conftest import Stack, serving
from tests.integration.specs import ENDLESS

pytestmark = pytest.mark.integration


@dataclass(frozen=True)
class Closed:
    """A running service that has keys, and a key of alice's."""

    stack: Stack
    keys: AccessKeys
    key: str
    prefix: str


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Closed]:
    data = tmp_path_factory.mktemp("closed") / "data"
    engine = connect(Settings(data=data))
    migrate(engine, Settings(data=data))
    keys = AccessKeys(engine)
    made, text = keys.create("alice", "alice", {Scope.JOBS_READ, Scope.JOBS_WRITE})
    with serving(data) as stack:
        stack.client.headers["authorization"] = f"Bearer {text}"
        yield Closed(stack, keys, text, made.prefix)
    engine.dispose()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page of a fresh profile. The browser may complain here: refusals are what is tested."""
    with fresh_page(browser) as page:
        yield page


@pytest.fixture
def job(closed: Closed) -> Iterator[str]:
    """A job of alice's that runs until it is cancelled; at the latest after the test."""
    job_id = closed.stack.submit(ENDLESS)
    yield job_id
    closed.stack.client.post(f"/v1/jobs/{job_id}/cancel")
    closed.stack.ended(job_id)


def sign_in(page: Page, closed: Closed, key: str) -> None:
    page.goto(f"{closed.stack.client.base_url}/")
    expect(page).to_have_title("Sign in · scene-attack")
    page.get_by_label("Key").fill(key)
    page.get_by_role("button", name="Sign in").click()


def test_a_person_signs_in_follows_a_job_cancels_it_and_signs_out(closed: Closed, page: Page, job: str) -> None:
    sign_in(page, closed, "sa_0123456789_wrong")
    expect(page.get_by_role("alert")).to_contain_text("No such key")
    sign_in(page, closed, closed.key)
    page.locator(f'a[href="/jobs/{job}"]').click()
    expect(job_state(page)).to_have_text("running")
    assert page.evaluate("document.cookie") == ""
    page.get_by_role("button", name="Cancel this job").click()
    expect(job_state(page)).to_have_text("cancelled")
    page.get_by_role("button", name="Sign out").click()
    expect(page).to_have_title("Sign in · scene-attack")
    page.goto(f"{closed.stack.client.base_url}/jobs/{job}")
    expect(page).to_have_title("Sign in · scene-attack")


def test_a_page_that_is_open_asks_to_sign_in_when_the_key_is_revoked(closed: Closed, page: Page) -> None:
    made, text = closed.keys.create("brief", "alice", {Scope.JOBS_READ})
    sign_in(page, closed, text)
    expect(page).to_have_title("Jobs · scene-attack")
    closed.keys.revoke(made.prefix)
    expect(page).to_have_title("Sign in · scene-attack")


ATTACKS = """<!doctype html><title>evil</title>
<iframe name="frame"></iframe>
<img src="URL/jobs/JOB">
<form id="form" method="post" target="frame" action="URL/jobs/JOB/cancel"></form>
<form id="api" method="post" target="frame" action="URL/v1/jobs/JOB/cancel"></form>
<form id="out" method="post" target="frame" action="URL/sign-out"></form>
<script>
  for (const id of ["form", "api", "out"]) document.getElementById(id).submit();
  const tries = ["cors", "no-cors"].flatMap(mode => ["/v1/jobs/JOB/cancel", "/jobs/JOB/cancel", "/sign-out"].map(path =>
    fetch("URL" + path, { method: "POST", mode, credentials: "include" }).then(() => "sent", () => "refused")));
  tries.push(fetch("URL/v1/jobs", { credentials: "include" }).then(answer => answer.text(), () => "refused"));
  Promise.all(tries).then(found => { document.body.dataset.found = found.join(" "); });
</script>
"""


@contextmanager
def another_site(page: str) -> Iterator[str]:
    """Serves a page on another port, and gives its URL, under another name of this machine."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(page.encode())

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f":{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1"], ids=["another site", "another port"])
def test_a_page_of_another_site_can_make_the_browser_do_nothing(
    closed: Closed, page: Page, job: str, host: str
) -> None:
    sign_in(page, closed, closed.key)
    expect(page).to_have_title("Jobs · scene-attack")
    base = str(closed.stack.client.base_url).rstrip("/")
    with another_site(ATTACKS.replace("URL", base).replace("JOB", job)) as place:
        page.goto(f"http://{host}{place}")
        page.wait_for_function("document.body.dataset.found")
        found = page.evaluate("document.body.dataset.found").split(" ")
    # Of a request without CORS the page learns only that there was an answer, which was a refusal.
    assert found == ["refused"] * 3 + ["sent"] * 3 + ["refused"]
    assert closed.stack.job(job)["state"] in ("queued", "running")
    page.goto(f"{base}/jobs/{job}")
    expect(page.get_by_role("button", name="Sign out")).to_be_visible()
