"""A network behind a URL: the protocol against a local server, and what is refused of an address or an answer."""

import base64
import io
import json
import socket
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from scene_attack.errors import InvalidRequest, JobFailure, Unreadable
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import parse
from scene_attack.targets import registry
from scene_attack.targets.custom.card import AllowList
from scene_attack.targets.custom.endpoint import MOST_IMAGES, Endpoint
from tests.unit.jobs.small import LIBRARY
from tests.unit.targets.custom.conftest import Scan
from tests.unit.targets.custom.small_network import folder

LABELS = ("red", "green", "blue")
SIZE = (8, 8)
Answer = Callable[[dict[str, Any]], tuple[int, dict[str, str], bytes]]


def means(request: dict[str, Any]) -> tuple[int, dict[str, str], bytes]:
    """The mean of each channel, times 20."""
    images = [torch.tensor(list(pixels(one).tobytes())).reshape(*SIZE, 3) for one in request["images"]]
    scores = [(20 * image.double().mean(dim=(0, 1)) / 255).tolist() for image in images]
    return 200, {}, json.dumps({"scores": scores}).encode()


def pixels(png: str) -> Image.Image:
    image = Image.open(io.BytesIO(base64.b64decode(png)))
    assert (image.format, image.mode, image.size) == ("PNG", "RGB", (SIZE[1], SIZE[0]))
    return image


class Server(ThreadingHTTPServer):
    """A local server that answers as a test says, and keeps what it was asked."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.answers: list[Answer] = [means]
        """The answers in order; the last is given again."""
        self.asked: list[dict[str, Any]] = []
        self.keys: list[str] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/classify"


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        assert self.path == "/classify"
        assert self.headers["Host"] == f"127.0.0.1:{self.server.server_address[1]}"
        answer = self.server.answers.pop(0) if len(self.server.answers) > 1 else self.server.answers[0]
        self.server.asked.append(body)
        self.server.keys.append(self.headers["Idempotency-Key"])
        status, headers, data = answer(body)
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        pass


@pytest.fixture
def server() -> Iterator[Server]:
    with Server() as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def target(url: str, **changes: Any) -> Endpoint:
    allowed = AllowList(endpoints=frozenset([url]))
    options: dict[str, Any] = {"probabilities": False, "weights_sha256": "0" * 64, "waits": (0.0, 0.0)}
    return Endpoint("far", url, LABELS, SIZE, **({"allowed": allowed} | options | changes))


def fixed(status: int, data: bytes = b"", **headers: str) -> Answer:
    return lambda _: (status, headers, data)


def test_scores_are_those_of_the_images_in_8_bits(server: Server) -> None:
    images = torch.rand(MOST_IMAGES + 3, *SIZE, 3, generator=torch.Generator().manual_seed(1))
    found = target(server.url).logits(images)
    wanted = 20 * (images * 255).round().mean(dim=(1, 2)) / 255
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=1e-5)
    assert [len(one["images"]) for one in server.asked] == [MOST_IMAGES, 3]
    assert not found.requires_grad
    larger = torch.full((1, 32, 24, 3), 0.2)
    torch.testing.assert_close(target(server.url).logits(larger), torch.full((1, 3), 4.0))


def test_probabilities_become_their_logarithms(server: Server) -> None:
    server.answers = [fixed(200, b'{"scores": [[0.5, 0.5, 0]]}')]
    found = target(server.url, probabilities=True).logits(torch.zeros(1, *SIZE, 3))
    torch.testing.assert_close(found.softmax(dim=1), torch.tensor([[0.5, 0.5, 0.0]]))


def test_a_server_that_is_busy_is_asked_again_with_the_same_request(server: Server) -> None:
    server.answers = [fixed(503), fixed(429), means]
    target(server.url).logits(torch.zeros(1, *SIZE, 3))
    assert len(server.asked) == 3
    assert server.asked[0] == server.asked[1] == server.asked[2]
    assert len(set(server.keys)) == 1
    target(server.url).logits(torch.ones(1, *SIZE, 3))
    assert len(set(server.keys)) == 2


def test_one_that_stays_away_is_unreachable(server: Server) -> None:
    server.answers = [fixed(503)]
    with pytest.raises(JobFailure, match=r"target-unreachable: .* did not answer in 3 tries: status 503"):
        target(server.url).logits(torch.zeros(1, *SIZE, 3))
    with socket.socket() as free:  # nobody listens on it
        free.bind(("127.0.0.1", 0))
        nobody = f"http://127.0.0.1:{free.getsockname()[1]}/"
        with pytest.raises(JobFailure, match=r"target-unreachable: .* did not answer in 3 tries"):
            target(nobody).logits(torch.zeros(1, *SIZE, 3))


@pytest.mark.parametrize("begun", [b"HTTP/1.1 200 OK\r\nServer: slow\r\n", b"HTTP/1.0 200 OK\r\n\r\n{"])
def test_an_answer_that_begins_and_never_ends_is_given_up(begun: bytes) -> None:
    def answer() -> None:
        for _ in range(3):
            connection, _ = listening.accept()
            with connection:
                connection.sendall(begun)
                while connection.recv(2**16):  # until the client gives up
                    pass

    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"http://127.0.0.1:{listening.getsockname()[1]}/"
        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        with pytest.raises(JobFailure, match=r"target-unreachable: .* in 3 tries: no whole answer in 0.1 s"):
            target(url, most_seconds=0.1).logits(torch.zeros(1, *SIZE, 3))
        thread.join()


WRONG: dict[str, tuple[Answer, str]] = {
    "a redirect": (fixed(302, Location="http://127.0.0.1:1/"), "status 302, a redirect, which is not followed"),
    "an error": (fixed(400), "status 400, not 200"),
    "a long answer": (fixed(200, b" " * 2**17), "more than 65,728 bytes"),
    "a compressed answer": (fixed(200, b"", **{"Content-Encoding": "gzip"}), "a compressed body"),
    "no JSON": (fixed(200, b"<html>"), "no JSON"),
    "no scores": (fixed(200, b'{"score": []}'), "no JSON"),
    "words": (fixed(200, b'{"scores": [["a", "b", "c"]]}'), "no JSON"),
    "too few scores": (fixed(200, b'{"scores": [[1, 2]]}'), r"scores of shape \[1, 2\] for 1 images; 1 lists of 3"),
    "uneven scores": (fixed(200, b'{"scores": [[1, 2, 3], [1]]}'), "no JSON"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_an_answer_that_is_none_of_the_protocol_ends_the_job(server: Server, wrong: str) -> None:
    answer, said = WRONG[wrong]
    server.answers = [answer]
    with pytest.raises(JobFailure, match=f"internal: .*answered with {said}"):
        target(server.url).logits(torch.zeros(1, *SIZE, 3))
    assert len(server.asked) == 1


REFUSED = {
    "https://other.test/": "is not allowed",
    "http://far.test/": "is neither https nor on this machine",
    "http://10.0.0.7/": "is neither https nor on this machine",
    "https://me:secret@far.test/": "a user name, a password or a fragment",
    "ftp://far.test/": "is neither https",
}


@pytest.mark.parametrize("url", REFUSED)
def test_addresses_that_are_refused(url: str) -> None:
    # The settings refuse such a list themselves; the rules of an address hold whatever is listed.
    allowed = AllowList(endpoints=frozenset(one for one in REFUSED if "other" not in one))
    assert REFUSED[url] in str(allowed.endpoint_refusal(url))
    with pytest.raises(Unreadable, match=REFUSED[url]):
        target(url, allowed=allowed)


@pytest.mark.parametrize(
    ("addresses", "listed", "chosen"),
    [
        (["93.184.216.34"], (), "93.184.216.34"),
        (["10.0.0.7"], (), None),
        (["127.0.0.1"], (), None),
        (["::ffff:10.0.0.7"], (), None),
        (["169.254.169.254"], (), None),
        (["10.0.0.7", "93.184.216.34"], (), "93.184.216.34"),
        (["10.0.0.7"], ("10.0.0.7",), "10.0.0.7"),
    ],
)
def test_a_name_may_not_lead_to_a_private_address(
    addresses: list[str], listed: tuple[str, ...], chosen: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, 443)) for address in addresses]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    allowed = AllowList(endpoints=frozenset(["https://far.test/", *listed]))
    if chosen is None:
        with pytest.raises(OSError, match="has no address that is public or listed"):
            allowed.resolve("far.test", 443)
    else:
        assert allowed.resolve("far.test", 443) == chosen


@pytest.mark.slow
def test_a_job_attacks_it_without_gradients_only(server: Server, scan: Scan, tmp_path: Path) -> None:
    folder(tmp_path, "far", endpoint=server.url, labels=list(LABELS), preprocessing={"input_size": SIZE})
    assert [one.error for one in scan(target_endpoints=server.url)] == [None]
    assert not registry.has_gradient("far")
    scene = {"camera": {"size": [32, 32]}, "objects": [{"mesh": "primitive/sphere"}]}
    job = {
        "scene": scene,
        "target": {"name": "far"},
        "attack": {"renderer": "pyrender", "groups": ["color"], "steps": 2},
    }
    result = execute(parse(job), tmp_path / "out", LIBRARY)
    assert result.cost.queries > 2
    assert result.provenance.backend.endswith(f"endpoint {server.url}")
    assert result.provenance.weights_sha256 == result.provenance.card_sha256
    job["attack"] = {"renderer": "torch", "method": "fgsm"}
    with pytest.raises(InvalidRequest, match=r"attack.method: fgsm needs gradients"):
        prepare(parse(job), LIBRARY)
    server.answers = [fixed(404)]
    registry.load.cache_clear()
    with pytest.raises(InvalidRequest, match=r"target 'far' fails on 2 RGB images .* status 404"):
        prepare(parse(job), LIBRARY)
