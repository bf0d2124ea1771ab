"""The list of jobs over HTTP: queries, cursors, what people say about jobs, also on their pages, and retries."""

from datetime import UTC, datetime
from typing import Any

import httpx
import pytest

from scene_attack.client.states import State
from scene_attack.runs.spec import parse
from scene_attack_api.cursors import Cursor, read_cursor, write_cursor
from scene_attack_api.requests import Services
from scene_attack_service.jobs.job_list import Place
from scene_attack_service.jobs.models import Job
from tests.unit.api.conftest import SPHERE
from tests.unit.api.dashboard_records import Tags

NOON = datetime(2026, 11, 28, 12, tzinfo=UTC)


@pytest.fixture
def three(services: Services) -> list[str]:
    """Three queued jobs with a tag of their own."""
    jobs = []
    for seed in range(3):
        job, _ = services.record.jobs.create(parse(SPHERE | {"seed": seed}), 1000, None, lambda _: {})
        assert isinstance(job, Job)
        services.record.lists.edit(job.id, {"tags": [f"three-{id(jobs)}"]})
        jobs.append(job.id)
    return jobs


def tag_of(client: httpx.Client, job: str) -> str:
    tag: str = client.get(f"/v1/jobs/{job}").json()["tags"][0]
    return tag


def test_pages_of_a_query_both_ways(client: httpx.Client, three: list[str]) -> None:
    asked = {"q": f"tag:{tag_of(client, three[0])} state:queued", "limit": 2, "sort": "created"}
    first = client.get("/v1/jobs", params=asked).json()
    assert [job["id"] for job in first["items"]] == three[:2]
    assert first["previous"] is None
    second = client.get("/v1/jobs", params=asked | {"cursor": first["next"]}).json()
    assert [job["id"] for job in second["items"]] == three[2:]
    assert second["next"] is None
    back = client.get("/v1/jobs", params=asked | {"cursor": second["previous"]}).json()
    assert back["items"] == first["items"]
    other = client.get("/v1/jobs", params=asked | {"cursor": first["next"], "sort": "p"})
    assert (other.status_code, other.json()["errors"][0]["field"]) == (422, "cursor")


def test_a_query_that_cannot_be_read_says_where(client: httpx.Client) -> None:
    answer = client.get("/v1/jobs", params={"q": "scene:a rendrer:torch"})
    assert answer.status_code == 422
    [error] = answer.json()["errors"]
    assert error["field"] == "q"
    assert error["detail"].startswith("at character 9: there is no field 'rendrer'")


@pytest.mark.parametrize(
    ("sort", "value"),
    [
        ("created", NOON),
        ("-ended", NOON),
        ("name", "a piano"),
        ("state", State.RUNNING),
        ("verified", False),
        ("p", 0.01),
        ("-queries", 7),
        ("seconds", 0.5),
        ("queries", None),
    ],
)
def test_a_cursor_keeps_its_place(sort: str, value: object) -> None:
    place = Place(value, NOON, "0f3c")
    assert read_cursor(write_cursor(sort, place, backwards=True), sort) == Cursor(before=place)


@pytest.mark.parametrize("cursor", ["x", "!!", "bm90IGEgY3Vyc29y", "bnVsbA", "W10", "WyItY3JlYXRlZCIsZmFsc2UsMSwyLDNd"])
def test_a_bad_cursor_is_refused(client: httpx.Client, cursor: str) -> None:
    answer = client.get("/v1/jobs", params={"cursor": cursor})
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "cursor")


def test_title_tags_and_note(client: httpx.Client, three: list[str]) -> None:
    said = {"title": "The piano", "tags": ["paper", "a"], "note": "see figure 3"}
    job = client.patch(f"/v1/jobs/{three[0]}", json=said).json()
    assert {key: job[key] for key in said} == said | {"tags": ["a", "paper"]}
    job = client.patch(f"/v1/jobs/{three[0]}", json={"note": None, "title": ""}).json()
    assert (job["title"], job["tags"], job["note"]) == (None, ["a", "paper"], None)
    assert client.get(f"/v1/jobs/{three[0]}").json() == job


@pytest.mark.parametrize(
    "wrong",
    [{"tags": ["a b"]}, {"tags": ["a"] * 21}, {"tags": [""]}, {"title": "a" * 101}, {"name": "x"}, {"note": 1}],
)
def test_bad_edits_are_refused(client: httpx.Client, three: list[str], wrong: dict[str, Any]) -> None:
    before = client.get(f"/v1/jobs/{three[0]}").json()
    assert client.patch(f"/v1/jobs/{three[0]}", json=wrong).status_code == 422
    assert client.get(f"/v1/jobs/{three[0]}").json() == before


def test_a_retry_is_a_new_job_of_the_same_request(client: httpx.Client, services: Services, three: list[str]) -> None:
    answer = client.post(f"/v1/jobs/{three[1]}/retry")
    job = answer.json()
    assert answer.status_code == 202
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}"
    assert (job["retry_of"], job["state"], job["checked"]) == (three[1], "queued", False)
    assert job["spec"] == client.get(f"/v1/jobs/{three[1]}").json()["spec"]
    assert services.record.lists.retries(three[1]) == [job["id"]]
    assert client.post("/v1/jobs/unknown/retry").status_code == 404
    assert client.patch("/v1/jobs/unknown", json={}).status_code == 404


HTML = {"accept": "text/html"}


@pytest.fixture
def queued(services: Services) -> str:
    job, _ = services.record.jobs.create(parse(SPHERE), 1000, None, lambda _: {})
    assert isinstance(job, Job)
    return job.id


def test_the_form_writes_title_tags_and_note(client: httpx.Client, queued: str) -> None:
    said = {"title": " The <b>ball</b> ", "tags": "paper, mine  paper", "note": "first\r\nsecond"}
    answer = client.post(f"/jobs/{queued}/about", data=said)
    assert (answer.status_code, answer.headers["location"]) == (303, f"/jobs/{queued}")
    job = client.get(f"/v1/jobs/{queued}").json()
    assert [job[name] for name in ("title", "tags", "note")] == ["The <b>ball</b>", ["mine", "paper"], "first\nsecond"]
    page = client.get(f"/jobs/{queued}")
    assert "<h1>The &lt;b&gt;ball&lt;/b&gt;</h1>" in page.text
    assert "/?q=tag%3Amine" in {link["href"] for link in Tags(page.text).all("a")}
    client.post(f"/jobs/{queued}/about", data={"title": "", "tags": "", "note": ""})
    job = client.get(f"/v1/jobs/{queued}").json()
    assert [job[name] for name in ("title", "tags", "note")] == [None, [], None]


@pytest.mark.parametrize("wrong", [{"title": "a" * 101}, {"tags": 'a "b"'}, {"tags": " ".join(map(str, range(21)))}])
def test_a_form_that_cannot_be_written_is_a_page_that_says_why(
    client: httpx.Client, queued: str, wrong: dict[str, str]
) -> None:
    answer = client.post(f"/jobs/{queued}/about", data=wrong, headers=HTML)
    assert answer.status_code == 422
    assert next(iter(wrong)) in Tags(answer.text).text.lower()
    assert client.get(f"/v1/jobs/{queued}").json()["title"] is None


def test_a_retry_from_the_page_leads_to_the_new_job_and_back(client: httpx.Client, queued: str) -> None:
    answer = client.post(f"/jobs/{queued}/retry")
    new = answer.headers["location"].removeprefix("/jobs/")
    assert (answer.status_code, client.get(f"/v1/jobs/{new}").json()["retry_of"]) == (303, queued)
    assert f"/jobs/{queued}" in {link["href"] for link in Tags(client.get(f"/jobs/{new}").text).all("a")}
    links = {link["href"] for link in Tags(client.get(f"/jobs/{queued}").text).all("a")}
    assert {f"/jobs/{new}", f"/compare?jobs={queued},{new}"} <= links


def test_a_job_that_has_ended_can_be_deleted_from_its_page(client: httpx.Client, finished: str, queued: str) -> None:
    def forms(job: str) -> set[str | None]:
        return {form["action"] for form in Tags(client.get(f"/jobs/{job}").text).all("form")}

    client.post(f"/jobs/{finished}/about", data={"tags": "gone"})
    assert f"/jobs/{queued}/delete" not in forms(queued)
    assert client.post(f"/jobs/{queued}/delete", headers=HTML).status_code == 409
    answer = client.post(f"/jobs/{finished}/delete")
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    assert client.get(f"/v1/jobs/{finished}").status_code == 404
    assert client.get("/v1/jobs", params={"q": "tag:gone"}).json()["items"] == []


def test_a_tag_that_is_none_is_answered_in_words(client: httpx.Client, queued: str) -> None:
    answer = client.patch(f"/v1/jobs/{queued}", json={"tags": ["paper", "two words"]})
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert error["field"] == "tags.1"
    assert error["detail"].startswith("a tag has 1 to 50 characters, without spaces")
