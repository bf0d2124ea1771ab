"""Lines of the log: JSON for programs, and for a person on a terminal."""

import json
import os
import pty
import re
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

CODE = """
from scene_attack.logs import bound, configure, logger
configure("worker")
key = "sa_" + "secret"
with bound(job="0f3c", attempt=2):
    logger("scene_attack_worker.main").warning("job taken back", worker="host-0")
try:
    raise ValueError("it broke")
except ValueError:
    logger("scene_attack_worker.main").exception("unexpected")
"""


def test_without_a_terminal_each_line_is_json() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], stderr=subprocess.PIPE, text=True, check=True)
    first, second = map(json.loads, done.stderr.splitlines())
    time = first.pop("timestamp")
    assert re.fullmatch(r"20\d\d-\d\d-\d\dT\d\d:\d\d:\d\d\.\d+Z", time)
    assert first == {
        "process": "worker", "level": "warning", "logger": "scene_attack_worker.main", "event": "job taken back",
        "job": "0f3c", "attempt": 2, "worker": "host-0",
    }  # fmt: skip
    assert "ValueError: it broke" in second["exception"]


def test_on_a_terminal_a_line_is_read_by_a_person_and_shows_no_variables() -> None:
    ours, terminal = pty.openpty()
    subprocess.run([sys.executable, "-c", CODE], stderr=terminal, check=True)
    os.close(terminal)
    with os.fdopen(ours, "rb") as shown:
        said = shown.read1(65536).decode()
    lines = re.sub(r"\x1b\[[0-9;]*m", "", said).splitlines()
    first = re.fullmatch(r"\d\d:\d\d:\d\d \[warning *\] job taken back +(.*)", lines[0])
    assert first is not None
    assert set(first[1].split()) == {"attempt=2", "job=0f3c", "process=worker", "worker=host-0"}
    assert lines[-1] == "ValueError: it broke"
    assert "secret" not in said
