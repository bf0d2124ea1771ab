"""The audit log says who changed what and who was refused, and holds no secret."""

from collections.abc import Iterator
from typing import Any

import pytest
from structlog.testing import capture_logs

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
    assert audited(lines) == [(owner, "GET /v1/jobs", "/v1/jobs", status)]


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
    assert audited(lines) == [(None, "POST -", "/" + "a" * 199, 401)]
