"""Messages to a receiver on this machine, which a setting has to allow."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from services.errors import InvalidRequest
from services.jobs.webhook_sending import check_url, headers, send
from services.jobs.webhooks import Message

SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
HERE = frozenset(["127.0.0.1"])
NOBODY: frozenset[str] = frozenset()


class Receiver(BaseHTTPRequestHandler):
    """Answers with the status in the path, and keeps what it got."""

    got: list[tuple[str, dict[str, str], bytes]]

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        self.got.append((self.path, {k.lower(): v for k, v in self.headers.items()}, body))
        if self.path == "/never":
            threading.Event().wait(1)
            return
        self.send_response(int(self.path[1:4]))
        self.send_header("location", "/200")
        self.end_headers()
        if self.path.endswith("endless"):
            while True:
                self.wfile.write(b"x" * 65536)

    def do_GET(self) -> None:
        self.do_POST()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[HTTPServer]:
    server = HTTPServer(("127.0.0.1", 0), Receiver)
    Receiver.got = []
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    server.handle_error = lambda *_: None  # type: ignore[method-assign]
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def message(url: str) -> Message:
    return Message("msg_1", '{"ü": 1}'.encode(), url, SECRET, 1)


def test_the_signature_is_that_of_standard_webhooks() -> None:
    """The example of the reference implementations."""
    given = Message("msg_p5jXN8AQM9LWM0D4loKWxJek", b'{"test": 2432232314}', "", SECRET, 1)
    assert headers(given, 1614265330)["webhook-signature"] == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_an_allowed_receiver_gets_the_message(receiver: HTTPServer) -> None:
    url = f"http://127.0.0.1:{receiver.server_port}/204?a=b"
    assert send(message(url), HERE) == (204, None)
    [(path, given, body)] = Receiver.got
    assert (path, body) == ("/204?a=b", '{"ü": 1}'.encode())
    assert (given["host"], given["webhook-id"]) == (f"127.0.0.1:{receiver.server_port}", "msg_1")
    assert given["content-type"] == "application/json"
    expected = headers(message(url), int(given["webhook-timestamp"]))
    assert given["webhook-signature"] == expected["webhook-signature"]


@pytest.mark.parametrize("status", [301, 302, 307, 400, 410, 500, 503])
def test_any_other_answer_is_an_error_and_redirects_are_not_followed(receiver: HTTPServer, status: int) -> None:
    url = f"http://127.0.0.1:{receiver.server_port}/{status}"
    assert send(message(url), HERE) == (status, f"it answered {status}")
    assert [path for path, _, _ in Receiver.got] == [f"/{status}"]


def test_an_endless_answer_is_not_read(receiver: HTTPServer) -> None:
    assert send(message(f"http://127.0.0.1:{receiver.server_port}/200-endless"), HERE) == (200, None)


def test_an_answer_that_does_not_come_is_given_up(receiver: HTTPServer) -> None:
    status, error = send(message(f"http://127.0.0.1:{receiver.server_port}/never"), HERE, seconds=0.2)
    assert status is None
    assert error is not None
    assert "Timeout" in error


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]", "2130706433", "127.1", "0.0.0.0"])
def test_an_address_that_is_not_public_is_not_connected_to(receiver: HTTPServer, host: str) -> None:
    status, error = send(message(f"http://{host}:{receiver.server_port}/200"), NOBODY)
    assert status is None
    assert error is not None
    assert Receiver.got == []
    assert "no public address" in error or "gaierror" in error


@pytest.mark.parametrize(
    "url",
    [
        "",
        "receiver.example",
        "ftp://receiver.example/",
        "http://receiver.example/",
        "https://",
        "https://[::1",
        "https://receiver.example:99999/",
        "https://user:password@receiver.example/",
        "https://receiver.example/#part",
        "https://receiver.example/a b",
        "https://receiver.example/\r\nHost: x",
        "https://receiver.example/ü",
        "https://127.0.0.1/",
        "https://169.254.169.254/latest/meta-data",
        "https://[::ffff:10.0.0.1]/",
        "https://receiver.example/" + "a" * 2000,
    ],
)
def test_urls_that_are_refused_at_once(url: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        check_url(url, NOBODY)
    assert raised.value.field == "url"


def test_urls_that_are_taken() -> None:
    check_url("https://receiver.example:8443/hook?a=b", NOBODY)
    check_url("http://127.0.0.1:8000/", HERE)
    check_url("http://receiver.local/", frozenset(["receiver.local"]))
