import json

import pytest
from httpx import Client

from tests.unit.api.conftest import SPHERE

pytestmark = pytest.mark.slow

JSON = {"content-type": "application/json"}

PROBLEMS = {
    "no such page": ("GET", "/v2/jobs", {}, 404),
    "wrong method": ("DELETE", "/v1/jobs", {}, 405),
    "not JSON": ("POST", "/v1/jobs", {"content": "{", "headers": JSON}, 400),
    "too large": ("POST", "/v1/jobs", {"content": b" " * (2**20 + 1), "headers": JSON}, 413),
    "a job as a form": ("POST", "/v1/jobs", {"data": {"scene": "x"}}, 415),
    "a job as text": ("POST", "/v1/jobs", {"content": "{}", "headers": {"content-type": "text/plain"}}, 415),
    "a job as nothing": ("POST", "/v1/jobs", {"content": "{}"}, 415),
    "a mesh as JSON": ("POST", "/v1/assets", {"json": {}}, 415),
    "another site": ("POST", "/v1/jobs/none/cancel", {"headers": {"origin": "http://evil.example"}}, 403),
    "another host": ("GET", "/healthz", {"headers": {"host": "evil.example:8008"}}, 421),
}


@pytest.mark.parametrize(("method", "path", "options", "status"), PROBLEMS.values(), ids=PROBLEMS.keys())
def test_every_error_is_a_problem(
    client: Client, method: str, path: str, options: dict[str, object], status: int
) -> None:
    answer = client.request(method, path, **options)  # type: ignore[arg-type]
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert problem["status"] == status
    assert problem["title"]
    assert problem["detail"]
    assert set(problem) == {"type", "title", "status", "detail", "errors"}


def test_the_site_itself_may_ask(client: Client) -> None:
    answer = client.post("/v1/jobs", json=SPHERE, headers={"origin": str(client.base_url).rstrip("/")})
    assert answer.status_code == 202


def test_a_vendor_json_type_is_json(client: Client) -> None:
    headers = {"content-type": "application/vnd.test+json; charset=utf-8"}
    assert client.post("/v1/jobs", content=json.dumps(SPHERE), headers=headers).status_code == 202
