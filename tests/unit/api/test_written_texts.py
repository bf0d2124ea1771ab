"""Names, titles, tags and notes: what no text may have is refused everywhere, and the field is named."""

from typing import Any

import pytest
from httpx import Client

from tests.unit.api.conftest import SPHERE

UNFIT = {"an escape": "a\x1b[31m", "an override": "a\u202eb", "an isolate": "a\u2066b", "nothing to see": " \u200b"}
LINES = {"a newline": "a\nb"}


def fields(answer: Any) -> list[str]:
    assert answer.status_code == 422, answer.text
    return [error["field"] for error in answer.json()["errors"]]


@pytest.mark.parametrize("text", [*UNFIT.values(), *LINES.values()], ids=[*UNFIT, *LINES])
def test_names_and_titles_are_lines(client: Client, finished: str, text: str) -> None:
    job = f"/v1/jobs/{finished}"
    assert fields(client.patch(job, json={"title": text})) == ["title"]
    assert fields(client.post(f"/jobs/{finished}/about", data={"title": text})) == ["title"]
    grid = {"scenes": [SPHERE["scene"]], "attacks": [{"name": text, "attack": SPHERE["attack"]}]}
    wrong = fields(client.post("/v1/campaigns", json={"name": text, "grids": [grid]}))
    assert wrong == ["name", "grids.0.attacks.0.name"]
    file = {"file": ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")}
    for field in ("name", "licence", "credit"):
        assert fields(client.post("/v1/assets", files=file, data={field: text})) == [field]


@pytest.mark.parametrize("text", UNFIT.values(), ids=UNFIT)
def test_a_tag_has_none(client: Client, finished: str, text: str) -> None:
    tag = text.replace(" ", "")
    assert fields(client.patch(f"/v1/jobs/{finished}", json={"tags": ["new", tag]})) == ["tags.1"]
    # Jobs of other tests, which the list would show, have outcomes that no job has.
    page = client.post("/jobs/selected", data={"action": "tag", "job": finished, "tag": tag, "q": "tag:none"})
    assert "a tag has 1 to 50 characters" in page.text
    assert client.patch(f"/v1/jobs/{finished}", json={}).json()["tags"] == []


def test_a_note_may_have_lines_and_no_escapes(client: Client, finished: str) -> None:
    job = f"/v1/jobs/{finished}"
    for text in ("a\x1b[31m", "a\u202eb", "a\u2066b"):
        assert fields(client.patch(job, json={"note": text})) == ["note"]
    assert client.patch(job, json={"note": "a\n\tb", "title": ""}).json()["note"] == "a\n\tb"


@pytest.mark.parametrize("text", ["a\x1b[31m", "name:\u202eb"])
def test_a_query_says_where_it_has_one(client: Client, text: str) -> None:
    answer = client.get("/v1/jobs", params={"q": text})
    assert fields(answer) == ["q"]
    assert "this is the character U+" in answer.json()["detail"]
