"""Requests that come slowly, to a server with short limits."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import suppress

import pytest
import uvicorn
from starlette.types import Receive, Scope, Send

from api.protocol import HEAD_BYTES, LimitedHttp
from api.slow_clients import BODY_PACE, BodyPace

LIMIT = 0.2
seen: dict[str, list[tuple[bytes, bytes]]] = {}
"""The headers of the last request."""


class QuickHead(LimitedHttp):
    head_seconds = LIMIT


async def length(scope: Scope, receive: Receive, send: Send) -> None:
    """Answers with the length of the body."""
    seen["headers"] = scope["headers"]
    total, more = 0, scope["path"] != "/early"
    while more:
        message = await receive()
        total, more = total + len(message["body"]), message["more_body"]
    body = json.dumps(total).encode()
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(body))]})
    await send({"type": "http.response.body", "body": body})


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    listener = socket.create_server(("127.0.0.1", 0))
    app = BodyPace(length, seconds=LIMIT)
    server = uvicorn.Server(uvicorn.Config(app, http=QuickHead, lifespan="off", log_config=None, timeout_keep_alive=60))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    yield listener.getsockname()[1]
    server.should_exit = True
    thread.join()
    listener.close()


@pytest.fixture
def connection(port: int) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", port), timeout=30) as made:
        yield made


def answer(connection: socket.socket) -> bytes:
    """All that comes until the server closes the connection."""
    said = b""
    while part := connection.recv(65536):
        said += part
    return said


@pytest.mark.parametrize("head", [b"", b"GET", b"GET / HTTP/1.1\r\nHost: localhost\r\nA: b"])
def test_a_head_that_does_not_end_is_given_up(connection: socket.socket, head: bytes) -> None:
    connection.sendall(head)
    said = answer(connection)
    assert said.startswith(b"HTTP/1.1 408 ")
    assert said.endswith(b"\r\ncontent-length: 0\r\n\r\n")


def test_a_second_request_that_does_not_end_is_given_up(connection: socket.socket) -> None:
    connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
    assert connection.recv(65536).startswith(b"HTTP/1.1 200 ")
    connection.sendall(b"GET / HT")
    assert answer(connection).startswith(b"HTTP/1.1 408 ")


@pytest.mark.parametrize(
    "head",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\nA: " + b"b" * 8 * HEAD_BYTES,
        b"GET / HTTP/1.1\r\nHost: localhost\r\n" + b"a: b\r\n" * HEAD_BYTES,
        b"GET /" + b"a" * 2 * HEAD_BYTES,
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: elsewhere\r\n\r\n",
        b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nA: b\r\n c\r\n\r\n",
        b"GET / HTTP/9.9\r\nHost: localhost\r\n\r\n",
        b"CONNECT localhost:1 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01",
    ],
    ids=["long line", "many lines", "long path", "no host", "hosts", "lengths", "fold", "version", "connect", "TLS"],
)
def test_a_head_that_is_none_is_refused(connection: socket.socket, head: bytes) -> None:
    with suppress(ConnectionError):  # it is closed before the whole of a long head is sent
        connection.sendall(head)
    assert connection.recv(1000).startswith(b"HTTP/1.1 400 ")
    with suppress(ConnectionError):
        while connection.recv(1000):
            pass


def test_headers_after_a_body_are_left_out(connection: socket.socket) -> None:
    connection.sendall(chunked(3).removesuffix(b"\r\n") + b"x-late: yes\r\n\r\n")
    with connection.makefile("rb") as answer:
        assert answer.readline().startswith(b"HTTP/1.1 200 ")
    assert (b"x-late", b"yes") not in seen["headers"]
    assert (b"transfer-encoding", b"chunked") in seen["headers"]


def test_headers_after_a_body_that_do_not_end_are_refused(connection: socket.socket) -> None:
    with suppress(ConnectionError):
        connection.sendall(chunked(3).removesuffix(b"\r\n") + b"x-late: " + b"y" * 4 * HEAD_BYTES)
    assert connection.recv(1000).startswith((b"HTTP/1.1 400 ", b"HTTP/1.1 408 "))


def test_the_rest_of_a_body_that_was_answered_has_to_come(connection: socket.socket) -> None:
    connection.sendall(b"POST /early HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nabc")
    assert b"HTTP/1.1 200 " in answer(connection)  # and it is closed


def test_a_body_that_does_not_come_is_given_up(connection: socket.socket) -> None:
    connection.sendall(b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\nabc")
    said = answer(connection)
    assert said.startswith(b"HTTP/1.1 408 ")
    assert b"the body came too slowly" in said


def test_a_large_body_has_the_time_that_it_takes(connection: socket.socket) -> None:
    size = 8 * BODY_PACE
    connection.sendall(b"POST / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: %d\r\n\r\n" % size)
    stop = threading.Event()
    for _ in range(8):
        connection.sendall(b"x" * BODY_PACE)
        stop.wait(LIMIT / 2)
    assert answer(connection).endswith(b"\r\n\r\n%d" % size)


def chunked(*sizes: int) -> bytes:
    """A request whose body has chunks of these sizes."""
    chunks = b"".join(b"%x\r\n%s\r\n" % (size, b"x" * size) for size in (*sizes, 0))
    return b"POST / HTTP/1.1\r\nhost: localhost\r\ntransfer-encoding: chunked\r\n\r\n" + chunks


def test_a_body_of_many_small_chunks_is_refused(connection: socket.socket) -> None:
    connection.sendall(chunked(*[1] * 2000))
    assert connection.recv(1000).startswith(b"HTTP/1.1 400 ")
    while connection.recv(1000):
        pass  # it is closed


def test_large_chunks_and_a_few_small_ones_are_taken_in_each_request(connection: socket.socket) -> None:
    for sizes in ([1] * 900, [1] * 900, [1000] * 100 + [1] * 1000):
        connection.sendall(chunked(*sizes))
        with connection.makefile("rb") as answer:
            assert answer.readline().startswith(b"HTTP/1.1 200 ")
            while answer.readline() != b"\r\n":
                pass
            assert json.loads(answer.read(len(str(sum(sizes))))) == sum(sizes)
