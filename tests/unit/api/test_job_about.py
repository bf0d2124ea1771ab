"""What people say about a job on its page, and its buttons, over HTTP."""

import httpx
import pytest

from api.requests import Services
from services.jobs.models import Job
from services.pipeline.spec import parse
from tests.unit.api.conftest import SPHERE
from tests.unit.api.test_dashboard_pages import Tags

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
