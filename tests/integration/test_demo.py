"""The demonstration, as `scripts/demo` starts it."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import httpx
import psutil
import pytest

from scene_attack_worker.commands.demo import ATTACKS, QUESTION
from tests.integration.conftest import PATIENCE

pytestmark = pytest.mark.integration


def in_background(*command: str, **environ: str) -> "subprocess.Popen[str]":
    """Started as a shell without job control starts what runs in the background: with SIGINT ignored."""
    return subprocess.Popen(
        ["sh", "-c", 'trap "" INT; exec "$@"', "sh", *command],
        env=os.environ | environ,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def address(process: "subprocess.Popen[str]") -> str:
    """Read from its standard error until it says where the service is."""
    assert process.stderr is not None
    for line in process.stderr:
        if found := re.match(r"service at (http://\S+),", line):
            return found[1]
    raise AssertionError("it ended before its service was ready")


ONE_SCENE = """
import sys

from scene_attack.__main__ import main
from scene_attack_worker.commands import demo

demo.SCENES = {"power drill": demo.SCENES["power drill"]}
sys.argv = ["scene-attack", "demo", "--once"]
main()
"""
"""The demonstration with one of its scenes. That the network has all of them right is in test_right_before."""


def test_once_runs_every_job_shows_the_table_and_leaves_nothing_running(tmp_path: Path) -> None:
    environ = {"SCENE_ATTACK_DATA": str(tmp_path), "SCENE_ATTACK_PORT": "0"}
    process = in_background(sys.executable, "-c", ONE_SCENE, **environ)
    url = address(process)
    tree = psutil.Process(process.pid).children(recursive=True)
    assert len(tree) >= 4  # supervisor, Redis, API, worker
    table, _ = process.communicate(timeout=840)
    assert process.returncode == 0, table
    rows = [line for line in table.splitlines() if re.search(r"\b(fooled|held)\b", line)]
    assert len(rows) == len(ATTACKS) + 1
    assert all("drill" in row for row in rows[:3])
    assert rows[3].split("│")[1].strip() in QUESTION["target"]["ask"]["question"]
    for row, attack in zip(
        rows, ("bump+dials+lamp", "torch combined fgsm", "pyrender", "normals+illumination"), strict=True
    ):
        assert attack in row
    for row in rows[:2]:
        assert "fooled" in row
        assert "yes" in row
    assert re.search(r"^surface of drill: dented by \d", table, re.M)
    assert f"Dashboard: SCENE_ATTACK_DATA={tmp_path / 'demo'} scene-attack serve" in table
    # Every scene was right before, so that every job counts.
    assert re.search(rf"Fooled and verified: \d+ of {len(rows)} attacks on scenes that the network had right", table)
    with pytest.raises(httpx.ConnectError):
        httpx.get(url)
    _, alive = psutil.wait_procs(tree, timeout=PATIENCE)
    assert not alive


SERVICE = "#!/bin/sh\necho ready http://127.0.0.1:9\nexec sleep 1000\n"
"""A program that stands for the service: it says that it is ready, and stays."""
RUNS_SERVICE = """
import sys
from pathlib import Path

from scene_attack_worker.commands.demo import running_service

sys.executable = sys.argv[1]
with running_service(Path(sys.argv[2]), {}) as (url, process):
    print(url, flush=True)
    process.wait()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_however_it_is_ended_its_service_ends_too(tmp_path: Path, number: signal.Signals) -> None:
    """That `serve` then ends what it started is in test_recovery and test_service_lock."""
    service = tmp_path / "service"
    service.write_text(SERVICE)
    service.chmod(0o755)
    process = in_background(sys.executable, "-c", RUNS_SERVICE, str(service), str(tmp_path / "data"))
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "http://127.0.0.1:9\n"
        children = psutil.Process(process.pid).children()
        assert len(children) == 1
        process.send_signal(number)
        process.communicate(timeout=PATIENCE)
        _, alive = psutil.wait_procs(children, timeout=PATIENCE)
        assert not alive
    finally:
        process.kill()
        process.communicate()
