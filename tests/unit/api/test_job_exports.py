import csv
import io

import httpx
import pytest

from scene_attack_api.requests import Services


def test_a_list_as_csv_and_json(client: httpx.Client, services: Services, finished: str) -> None:
    services.record.lists.edit(finished, {"title": "=cmd()", "tags": ["b", "a"]})
    answer = client.get("/v1/jobs.csv", params={"q": f"id:{finished}"})
    assert answer.headers["content-disposition"] == 'attachment; filename="jobs.csv"'
    [row] = csv.DictReader(io.StringIO(answer.text))
    columns = ("id", "title", "tags", "p", "verified")
    assert [row[name] for name in columns] == [finished, "'=cmd()", "a b", "0.0025", "True"]
    [job] = client.get("/v1/jobs.json", params={"job": finished}).json()["items"]
    assert (job["title"], job["tags"], job["p"], job["outcome"]) == ("=cmd()", ["a", "b"], 0.0025, "fooled")
    assert client.get("/v1/jobs.json", params={"job": "f" * 32}).json() == {"items": []}
    assert client.get("/v1/jobs.csv", params={"q": "rendrer:x"}).status_code == 422


@pytest.mark.parametrize("begin", ["=", "+", "-", "@", "\t=", "\r=", "\n=", " ="])
def test_no_title_and_no_tags_are_a_formula(
    client: httpx.Client, services: Services, finished: str, begin: str
) -> None:
    services.record.lists.edit(finished, {"title": f"{begin}cmd()", "tags": [f"{begin.strip()}cmd()"]})
    table = client.get("/v1/jobs.csv", params={"job": finished}).text
    [row] = csv.DictReader(io.StringIO(table, newline=""))
    assert (row["title"], row["tags"]) == (f"'{begin}cmd()", f"'{begin.strip()}cmd()")


@pytest.mark.parametrize("query", ["job=", "job=&job=", "job=%20", "job=*", "q=id:", "q=id:%22%22"])
@pytest.mark.parametrize("path", ["/v1/jobs.csv", "/v1/jobs.json"])
def test_an_empty_id_is_not_every_job(client: httpx.Client, path: str, query: str) -> None:
    answer = client.get(f"{path}?{query}")
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["field"] == ("q" if query.startswith("q") else "job")
    assert "^[" not in answer.text


@pytest.mark.parametrize(
    ("query", "field"),
    [
        ("/v1/jobs?campaign=", "campaign"),
        ("/compare?job=&job=", "jobs"),
        ("/compare?jobs=", "jobs"),
        ("/compare?jobs=a,,b", "jobs"),
        ("/compare/campaigns?campaigns=,", "campaigns"),
    ],
)
def test_no_id_of_a_list_is_empty(client: httpx.Client, query: str, field: str) -> None:
    answer = client.get(query)
    assert answer.status_code == 422, answer.text
    assert [error["field"] for error in answer.json()["errors"]] == [field]
