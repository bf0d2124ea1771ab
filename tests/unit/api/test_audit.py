"""The log of requests says who changed what and who was refused, and holds no secret; each has its id."""

import json
import logging
from collections.abc import Iterator
from typing import Any

import pytest
from httpx import Client
from structlog.testing import capture_logs

from scene_attack import logs
from scene_attack_api.problems import REQUEST_ID
from tests.unit.api.conftest import SPHERE
from tests.unit.api.guarded import Guarded


@pytest.fixture
def lines(guarded: Guarded) -> Iterator[list[dict[str, Any]]]:  # noqa: ARG001 - it starts the service
    with capture_logs() as found:
        yield found  # type: ignore[misc]


def audited(lines: list[dict[str, Any]]) -> list[tuple[Any, ...]]:
    return [
        (line["owner"], line["route"], line["object"], line["status"]) for line in lines if line["event"] == "audit"
    ]


def test_a_change_and_who_made_it(guarded: Guarded, lines: list[dict[str, Any]]) -> None:
    guarded.ask("POST /v1/jobs/{job_id}/cancel", "bob")
    guarded.ask("GET /v1/jobs/{job_id}", "alice")  # reading is not logged
    route, path = "POST /v1/jobs/{job_id}/cancel", f"/v1/jobs/{guarded.job}/cancel"
    assert audited(lines) == [("bob", route, path, 404)]
    [line] = [line for line in lines if line["event"] == "audit"]
    assert guarded.headers["bob"]["authorization"].startswith(f"Bearer {line['key']}_")
    assert line["client"] == "127.0.0.1"


def test_what_was_made_is_named(guarded: Guarded, lines: list[dict[str, Any]]) -> None:
    made = guarded.client.post(f"/v1/campaigns/{guarded.campaign}/resume", headers=guarded.headers["alice"])
    assert made.status_code == 202
    assert audited(lines)[0][2] == f"/v1/campaigns/{guarded.campaign}/resume"


@pytest.mark.parametrize(
    ("caller", "host", "owner", "status"),
    [
        ("none", "localhost", None, 401),
        ("revoked", "localhost", None, 401),
        ("only assets:write", "localhost", "alice", 403),
        ("alice", "other.example", None, 421),
    ],
)
def test_refusals(
    guarded: Guarded, lines: list[dict[str, Any]], caller: str, host: str, owner: str | None, status: int
) -> None:
    guarded.client.get("/v1/jobs?secret=1", headers={"host": host} | guarded.headers[caller])
    assert audited(lines) == [(owner, "GET none", "/v1/jobs", status)]


def test_signing_in_is_logged_with_the_keys_prefix_and_without_its_text(
    guarded: Guarded, lines: list[dict[str, Any]]
) -> None:
    text = guarded.headers["alice"]["authorization"].removeprefix("Bearer ")
    for key in (text, f"{text}x"):
        guarded.client.post("/sign-in", data={"key": key})
        guarded.client.cookies.clear()
    assert audited(lines) == [("alice", "POST /sign-in", "/sign-in", 303), (None, "POST /sign-in", "/sign-in", 401)]
    assert text not in str(lines)
    assert "x" * 20 not in str(lines)


def test_a_path_of_any_length_makes_a_short_line(guarded: Guarded, lines: list[dict[str, Any]]) -> None:
    guarded.client.post("/" + "a" * 5000)
    assert audited(lines) == [(None, "POST none", "/" + "a" * 199, 401)]


@pytest.mark.parametrize("given", ["a", "0af7651916cd43dd8448eb211c80319c", "proxy-1:2_3.4", "x" * 128])
def test_the_id_of_a_client_or_proxy_is_returned(client: Client, given: str) -> None:
    assert client.get("/healthz", headers={REQUEST_ID: given}).headers[REQUEST_ID] == given


@pytest.mark.parametrize("given", ["", "x" * 129, "a b", "ä", "a\tb", '{"a": 1}', "<script>"])
def test_another_one_is_replaced(client: Client, given: str) -> None:
    answers = [client.get("/v1/jobs/none", headers=[(REQUEST_ID.encode(), given.encode("latin-1"))]) for _ in range(2)]
    made = {answer.headers[REQUEST_ID] for answer in answers}
    assert len(made) == 2
    assert all(len(one) == 32 for one in made)


def test_lines_carry_the_ids_of_request_job_and_attempt(
    client: Client, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    logs.configure("test")
    client.post("/v1/jobs", json=SPHERE, headers={REQUEST_ID: "mine"})
    with logs.bound(job="ab", attempt=2):
        logging.getLogger("a.library").warning("careful")
    logging.getLogger("a.library").warning("without")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines() if line.startswith("{")]
    [queued] = [line for line in lines if line["event"] == "job queued"]
    assert (queued["request"], queued["process"]) == ("mine", "test")
    [careful] = [line for line in lines if line["event"] == "careful"]
    assert (careful["job"], careful["attempt"]) == ("ab", 2)
    [without] = [line for line in lines if line["event"] == "without"]
    assert "job" not in without
