"""Clients that send, or read, slowly do not keep the service from answering others."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest
from httpx import Client

from scene_attack_api.main import MOST_CONNECTIONS
from tests.integration.conftest import Stack, until
from tests.integration.specs import QUICK

pytestmark = pytest.mark.integration

JSON = b"POST /v1/jobs HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
FORM = b"POST /v1/assets HTTP/1.1\r\nHost: localhost\r\nContent-Type: multipart/form-data; boundary=b\r\n"
FILE = b'--b\r\ncontent-disposition: form-data; name="file"; filename="m.obj"\r\n\r\nv 0 0 0\n'
BEGINNINGS = {
    "no head": (b"", 40),
    "half a head": (b"GET /v1/jobs HTTP/1.1\r\nHost: localhost\r\nX-Slow: ", 40),
    "half a body": (JSON + b"Content-Length: 1000000\r\n\r\n{", 40),
    "half a chunk": (JSON + b"Transfer-Encoding: chunked\r\n\r\n10000\r\n{", 36),
    "half an upload": (FORM + b"Content-Length: 1000000\r\n\r\n" + FILE, 4),
    "an answer that is not read": (b"GET /openapi.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20, 40),
}
"""What slow clients have sent, and how many do so: 200 in all."""


@contextmanager
def connected(client: Client, beginnings: list[bytes]) -> Iterator[list[socket.socket]]:
    """Connections that have sent these bytes, and wait."""
    address = (client.base_url.host, client.base_url.port or 80)
    with ExitStack() as opened:
        connections = [opened.enter_context(socket.create_connection(address, timeout=60)) for _ in beginnings]
        for connection, beginning in zip(connections, beginnings, strict=True):
            connection.sendall(beginning)
        yield connections


def test_two_hundred_slow_clients_hold_up_nobody(stack: Stack) -> None:
    beginnings = [sent for sent, many in BEGINNINGS.values() for _ in range(many)]
    assert len(beginnings) == 200
    mesh = {"file": ("m.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")}
    with connected(stack.client, beginnings) as connections:
        job = stack.submit(QUICK)
        for sent, connection in zip(beginnings, connections, strict=True):
            if sent and b"openapi" not in sent:
                connection.sendall(b"a")  # each is still there, and goes on
            assert stack.client.get("/healthz").status_code == 200
        assert stack.client.get("/v1/jobs").status_code == 200
        assert stack.client.post("/v1/assets", files=mesh).status_code == 201
        assert stack.ended(job)["state"] == "succeeded"
        half_a_head = connections[beginnings.index(BEGINNINGS["half a head"][0])]
        half_a_head.sendall(b"\r\n\r\n")
        assert half_a_head.recv(100).startswith(b"HTTP/1.1 200 ")


def test_more_connections_than_the_server_takes_are_told_so_until_there_are_fewer(stack: Stack) -> None:
    with connected(stack.client, [b""] * MOST_CONNECTIONS):
        until(lambda: stack.client.get("/healthz").status_code == 503, "the server refuses")
    until(lambda: stack.client.get("/healthz").status_code == 200, "the server answers again")
