"""An owner that has too much is told when to try again; others are not held up."""

import socket
from contextlib import ExitStack

import pytest

from api.middleware import MAX_OPEN_UPLOADS
from services.access.caller import Quotas
from tests.unit.api.guarded import ATTACK, CAMPAIGN, SPHERE, Guarded
from tests.unit.api.test_owners import upload

JOB = {"scene": SPHERE, "attack": ATTACK}


@pytest.fixture
def nothing_more(guarded: Guarded, monkeypatch: pytest.MonkeyPatch) -> Guarded:
    """The service with quotas that are used up by one job, one campaign and no upload."""
    quotas = Quotas(guarded.services.assets, queued=1, campaigns=1, upload_bytes=0)
    for name in ("queued", "campaigns", "upload_bytes"):
        monkeypatch.setitem(vars(guarded.services.quotas), name, vars(quotas)[name])
    return guarded


def test_too_many_queued_jobs(nothing_more: Guarded) -> None:
    answer = nothing_more.client.post("/v1/jobs", json=JOB, headers=nothing_more.headers["alice"])
    assert answer.status_code == 429, answer.text
    assert int(answer.headers["retry-after"]) > 0
    assert "1 jobs queued" in answer.json()["detail"]
    mine = nothing_more.client.post("/v1/jobs", json=JOB, headers=nothing_more.headers["bob"])
    assert mine.status_code == 202
    nothing_more.client.post(f"{mine.headers['location']}/cancel", headers=nothing_more.headers["bob"])


def test_too_many_campaigns_that_have_not_ended(nothing_more: Guarded) -> None:
    answer = nothing_more.client.post("/v1/campaigns", json=CAMPAIGN, headers=nothing_more.headers["alice"])
    assert answer.status_code == 429, answer.text
    assert int(answer.headers["retry-after"]) > 0
    assert "1 campaigns" in answer.json()["detail"]


def test_too_many_uploaded_bytes(nothing_more: Guarded) -> None:
    answer = upload(nothing_more, "alice")
    assert answer.status_code == 429, answer.text
    assert int(answer.headers["retry-after"]) > 0


def half_an_upload(guarded: Guarded, caller: str) -> socket.socket:
    """A connection over which an upload has begun: the service waits for its bytes."""
    url = guarded.client.base_url
    connection = socket.create_connection((url.host, url.port), timeout=60)
    head = {
        "host": f"{url.host}:{url.port}",
        "content-type": "multipart/form-data; boundary=b",
        "content-length": "9000",
    }
    head |= {"expect": "100-continue"} | guarded.headers[caller]
    lines = ["POST /v1/assets HTTP/1.1", *(f"{name}: {text}" for name, text in head.items()), "", ""]
    connection.sendall("\r\n".join(lines).encode())
    assert connection.recv(1000).startswith(b"HTTP/1.1 100 ")
    return connection


def finish(connection: socket.socket) -> None:
    """Sends what is left of an upload, which is no upload, and waits for the answer."""
    connection.sendall(b"x" * 9000)
    assert connection.recv(1000).startswith(b"HTTP/1.1 4")


def test_too_many_open_uploads(guarded: Guarded) -> None:
    with ExitStack() as opened:
        connections = [opened.enter_context(half_an_upload(guarded, "alice")) for _ in range(MAX_OPEN_UPLOADS)]
        answer = upload(guarded, "alice")
        assert answer.status_code == 429, answer.text
        assert int(answer.headers["retry-after"]) > 0
        assert upload(guarded, "bob").status_code == 201
        finish(connections[0])
        assert upload(guarded, "alice").status_code == 201
        for connection in connections[1:]:  # one that is cut off would be logged later, while another test looks
            finish(connection)
