"""The commands are run as a reader runs them; a server takes what they send."""

import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from scene_attack_api.dashboard.job_page import commands

pytestmark = pytest.mark.slow

SPEC = {
    "scene": {"objects": [{"mesh": 'it\'s $HOME """ \\n `x` é\nJSON\n'}], "empty": ""},
    "seed": 3,
    "on": True,
    "no": None,
}


@pytest.fixture
def taken() -> Iterator[tuple[str, list[tuple[dict[str, str], Any]]]]:
    """The address of a server that takes jobs, and what it has taken: headers and body."""
    found: list[tuple[dict[str, str], Any]] = []

    class Taking(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            found.append((dict(self.headers), json.loads(body)))
            self.send_response(202)
            self.send_header("Content-Type", "application/json")
            self.end_headers()
            self.wfile.write(b'{"id": "1f", "state": "queued"}')

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Taking)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}", found
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.mark.parametrize("with_key", [False, True])
@pytest.mark.parametrize("name", ["as-curl", "as-python"])
def test_curl_and_python_send_the_request(
    taken: tuple[str, list[tuple[dict[str, str], Any]]], name: str, with_key: bool
) -> None:
    address, found = taken
    [command] = [one for one in commands(SPEC, address, with_key) if one.id == name]
    program = ["bash", "-c", command.text] if name == "as-curl" else [sys.executable, "-c", command.text]
    if name == "as-curl" and shutil.which("curl") is None:
        pytest.skip("there is no curl")
    subprocess.run(program, check=True, env=os.environ | {"SCENE_ATTACK_KEY": "sa_1"}, capture_output=True)
    [(headers, body)] = found
    assert body == SPEC
    assert headers.get("Content-Type", headers.get("content-type")) == "application/json"
    assert headers.get("Authorization") == ("Bearer sa_1" if with_key else None)


def test_the_command_line_gets_the_request_and_the_address(tmp_path: Any) -> None:
    """A stand-in for the program shows what the shell gives it."""
    program = tmp_path / "scene-attack"
    program.write_text('#!/bin/sh\nprintf "%s %s\\n" "$SCENE_ATTACK_URL" "$*"\ncat\n')
    program.chmod(0o755)
    [command] = [one for one in commands(SPEC, "http://host:8008", True) if one.id == "as-cli"]
    environ = {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    shown = subprocess.run(["bash", "-c", command.text], check=True, env=environ, capture_output=True, text=True).stdout
    first, _, rest = shown.partition("\n")
    assert first == "http://host:8008 submit --watch -"
    assert json.loads(rest) == SPEC
