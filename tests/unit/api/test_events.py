import json

import pytest
from httpx import Client

from scene_attack_api.authentication import COOKIE
from scene_attack_service.access.caller import Scope
from tests.unit.api.guarded import Guarded, bearer


def stream(client: Client, job_id: str, **headers: str) -> list[tuple[int, str, dict[str, object]]]:
    found = []
    with client.stream("GET", f"/v1/jobs/{job_id}/events", headers=headers) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/event-stream")
        for block in answer.read().decode().strip().split("\n\n"):
            fields = dict(line.split(": ", 1) for line in block.splitlines() if not line.startswith(":"))
            found.append((int(fields["id"]), fields["event"], json.loads(fields["data"])))
    return found


def test_all_events_are_told_and_the_stream_ends_with_the_job(client: Client, finished: str) -> None:
    told = stream(client, finished)
    assert [(number, kind) for number, kind, _ in told] == [
        (1, "state"),
        (2, "state"),
        (3, "progress"),
        (4, "state"),
    ]
    assert [data["state"] for _, kind, data in told if kind == "state"] == ["queued", "running", "succeeded"]
    assert told[2][2] == {"phase": "attacking", "step": 1, "steps": 2, "rows": [{"step": 1}]}


def test_a_reader_goes_on_where_it_left(client: Client, finished: str) -> None:
    assert [number for number, _, _ in stream(client, finished, **{"Last-Event-ID": "2"})] == [3, 4]


def test_a_reader_that_has_heard_everything_is_told_not_to_come_back(client: Client, finished: str) -> None:
    answer = client.get(f"/v1/jobs/{finished}/events", headers={"Last-Event-ID": "4"})
    assert answer.status_code == 204
    assert answer.content == b""


def test_a_number_that_is_none_is_refused(client: Client, finished: str) -> None:
    answer = client.get(f"/v1/jobs/{finished}/events", headers={"Last-Event-ID": "two"})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["field"] == "last-event-id"


def test_events_of_no_job(client: Client) -> None:
    assert client.get("/v1/jobs/none/events").status_code == 404


@pytest.mark.parametrize("by", ["key", "session"])
def test_a_stream_ends_when_its_key_is_revoked(guarded: Guarded, monkeypatch: pytest.MonkeyPatch, by: str) -> None:
    monkeypatch.setattr("scene_attack_api.watchers.KEY_SECONDS", 0.0)
    keys = guarded.services.keys
    key, text = keys.create("watching", "alice", {Scope.JOBS_READ})
    headers = bearer(text) if by == "key" else {"cookie": f"{COOKIE}={guarded.services.sessions.begin(key.prefix)}"}
    path = f"/v1/jobs/{guarded.job}/events"
    with guarded.client.stream("GET", path, headers=headers) as answer:
        said = answer.iter_lines()
        assert next(said).startswith(("id:", "event:", "data:", ":"))
        keys.revoke(key.prefix)
        assert not any("succeeded" in one for one in said)  # it ends, though the job does not
    assert guarded.client.get(path, headers=headers).status_code == 401
