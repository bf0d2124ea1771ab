import gzip
import re

import pytest
from httpx import Client

from scene_attack_api.dashboard.pages import prose

GZIP = {"accept-encoding": "gzip"}
PLAIN = {"accept-encoding": "identity"}


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/targets", "/v1/campaigns", "/openapi.json", "/v1/scenes"])
def test_a_client_that_has_an_answer_gets_none_again(client: Client, path: str) -> None:
    first = client.get(path, headers=GZIP)
    assert first.headers["etag"].startswith('W/"')
    assert first.headers["cache-control"] == "private, no-cache"
    for known in (first.headers["etag"], f'"other", {first.headers["etag"]}', "*"):
        again = client.get(path, headers=GZIP | {"if-none-match": known})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", first.headers["etag"])
        assert "content-type" not in again.headers
        assert "content-length" not in again.headers
    other = client.get(path, headers=PLAIN | {"if-none-match": '"other"'})
    assert (other.status_code, other.headers["etag"]) == (200, first.headers["etag"])


def test_a_job_has_another_etag_once_it_has_changed(client: Client, finished: str) -> None:
    before = client.get("/v1/jobs").headers["etag"]
    assert client.post(f"/v1/jobs/{finished}/cancel").status_code == 202
    assert client.get("/v1/jobs", headers={"if-none-match": before}).status_code == 304
    from tests.unit.api.conftest import SPHERE

    made = client.post("/v1/jobs", json=SPHERE)
    assert "etag" not in made.headers
    assert client.get("/v1/jobs", headers={"if-none-match": before}).status_code == 200


@pytest.mark.parametrize("path", ["/v1/jobs", "/v1/jobs/none", "/v1/jobs/none/events", "/healthz"])
def test_errors_and_posts_have_no_etag(client: Client, path: str) -> None:
    for answer in (client.get(path), client.put(path), client.post(path, content=b"{")):
        assert answer.status_code == 200 or "etag" not in answer.headers


def test_long_answers_are_compressed_for_those_who_ask(client: Client) -> None:
    with client.stream("GET", "/openapi.json", headers=GZIP) as packed:
        raw = b"".join(packed.iter_raw())
    plain = client.get("/openapi.json", headers=PLAIN)
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert gzip.decompress(raw) == plain.content
    assert len(raw) < len(plain.content) / 4
    assert packed.headers["vary"].lower() == plain.headers["vary"].lower() == "accept-encoding"
    assert client.get("/docs", headers=GZIP).headers["content-encoding"] == "gzip"


def test_short_answers_events_and_files_are_not(client: Client, finished: str) -> None:
    for path in ("/healthz", f"/v1/jobs/{finished}/events", f"/v1/jobs/{finished}/artifacts/original.png"):
        answer = client.get(path, headers=GZIP)
        assert answer.status_code == 200
        assert "content-encoding" not in answer.headers


def test_pages_load_nothing_from_elsewhere_and_all_else_loads_nothing(client: Client) -> None:
    for path in ("/v1/jobs", "/v1/jobs/none", "/metrics", "/healthz"):
        assert client.get(path).headers["content-security-policy"] == "default-src 'none'; frame-ancestors 'none'"
    for path in ("/", "/docs", "/campaigns", "/jobs/none"):
        page = client.get(path, headers={"Accept": "text/html"})
        assert page.headers["content-security-policy"].startswith("default-src 'none'; img-src 'self'")
        assert not re.findall(r'(?:src|href)="(?:https?:)?//', page.text)


def test_the_description_in_words_names_every_operation_and_type(client: Client) -> None:
    described, page = client.get("/openapi.json").json(), client.get("/docs").text
    assert "With <code>Prefer: wait=N</code> the answer" in page
    for path, methods in described["paths"].items():
        for method in methods:
            assert f"<code>{method.upper()} {path}</code>" in page
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(described["components"]["schemas"]) <= set(ids)
    assert set(re.findall(r'href="#([^"]+)"', page)) <= {*ids, "content"}
    assert "number, at least 0.05, at most 100.0" in page


def test_prose_is_escaped_and_has_code_between_backticks() -> None:
    assert prose("a `<b>` & `c") == "a <code>&lt;b&gt;</code> &amp; <code>c</code>"
