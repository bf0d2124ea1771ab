"""A service on a real socket that answers what each test scripts, and the JSON of answers."""

import json
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import scene_attack.client.client as client_module
from scene_attack import Client
from scene_attack.cli.app import app

EXAMPLES = json.loads((Path(__file__).parents[3] / "api" / "scene_attack_api" / "examples.json").read_text("utf-8"))
SUCCEEDED: dict[str, Any] = EXAMPLES["get_job"]["answer"]
"""A job of a real service, with its result."""
UPLOADED: dict[str, Any] = EXAMPLES["upload_asset"]["answer"]
CAMPAIGN: dict[str, Any] = EXAMPLES["get_campaign"]["answer"]

Answer = Callable[[BaseHTTPRequestHandler], None]


def job(**fields: object) -> dict[str, Any]:
    """A running job without a result, with these fields."""
    unsaid = {"title": None, "note": None, "tags": [], "warnings": []}
    return SUCCEEDED | unsaid | {"state": "running", "outcome": None, "result": None} | fields


class Script:
    """Answers, one for each request in turn, and the requests that came, with their bodies."""

    def __init__(self) -> None:
        self.answers: list[Answer] = []
        self.seen: list[tuple[str, str, dict[str, str]]] = []
        self.bodies: list[bytes] = []
        self.pauses: list[float] = []
        """Seconds for which a client would have waited."""

    @property
    def paths(self) -> list[str]:
        return [f"{method} {path}" for method, path, _ in self.seen]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Script:
    script = Script()

    async def pause(seconds: float) -> None:
        script.pauses.append(seconds)

    # Client and server are one process: if the machine pauses it, the clients' clocks go on, and a request would end.
    monkeypatch.setattr(client_module, "PATIENCE", None)
    monkeypatch.setattr(client_module, "sleep", script.pauses.append)
    monkeypatch.setattr(client_module, "async_sleep", pause)
    return script


@pytest.fixture
def client(script: Script) -> Iterator[Client]:
    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            script.bodies.append(self.rfile.read(int(self.headers.get("Content-Length", 0))))
            script.seen.append((self.command, self.path, dict(self.headers)))
            script.answers.pop(0)(self)

        do_GET = do_POST = do_PATCH = do_DELETE = answer  # noqa: N815

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    with Client(f"http://127.0.0.1:{server.server_port}/") as made:
        yield made
    server.shutdown()
    thread.join()
    server.server_close()


def says(status: int, body: object, kind: str = "application/json", **headers: str) -> Answer:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        handler.send_response(status)
        handler.send_header("Content-Type", kind)
        handler.send_header("Content-Length", str(len(data)))
        for name, value in headers.items():
            handler.send_header(name.replace("_", "-"), value)
        handler.end_headers()
        handler.wfile.write(data)

    return answer


def streams(*events: tuple[int, str, dict[str, object]], drop: bool = False) -> Answer:
    """Events; then the stream ends, or the connection breaks in the middle of one."""

    def answer(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", "text/event-stream")
        text = "".join(f"id: {n}\nevent: {kind}\ndata: {json.dumps(data)}\n\n" for n, kind, data in events)
        if drop:
            handler.send_header("Content-Length", "100000")
            text += "id: 99\nevent: state\ndata: {"
        handler.end_headers()
        handler.wfile.write(text.encode())

    return answer


RUNNING = (1, "state", {"state": "running"})
DONE = (3, "state", {"state": "succeeded"})


def progress(number: int) -> tuple[int, str, dict[str, object]]:
    return number, "progress", {"phase": "attacking", "step": number, "steps": 9, "rows": []}


def printed(client: Client, *arguments: str, stdin: str | None = None) -> str:
    """What a command prints on a wide terminal when it is called with this service; it has to succeed."""
    done = CliRunner().invoke(app, [*arguments, "--url", client.url], input=stdin, env={"COLUMNS": "200"})
    assert done.exit_code == 0, done.output
    return done.output
