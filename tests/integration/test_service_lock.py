"""One data folder has one `serve`, whose parts and whose successor are let in."""

import json
import signal
from pathlib import Path

import psutil
import pytest

from tests.integration.machine import Machine

pytestmark = pytest.mark.integration


def test_a_second_service_on_a_folder_is_refused(tmp_path: Path, redis_url: str) -> None:
    folder = tmp_path / "data"
    machine = Machine(tmp_path / "home", SCENE_ATTACK_REDIS_URL=redis_url, SCENE_ATTACK_DATA=str(folder))
    with machine.popen("serve", "--port", "0") as first:
        assert first.stderr is not None
        logged = (json.loads(line) for line in first.stderr if line.startswith("{"))
        port = next(line["address"][1] for line in logged if line["event"] == "listening")
        code, _, stderr = machine.run("serve", "--port", "0")
        said = f"a service runs on {folder} already, process {first.pid} at http://127.0.0.1:{port}; use that one"
        assert (code, said in stderr) == (2, True), stderr
        with machine.logging("worker") as log:  # another part of the deployment
            assert any(line["event"] == "program started" for line in log)
        tree = psutil.Process(first.pid).children(recursive=True)
        first.send_signal(signal.SIGKILL)
        first.communicate()
    gone, alive = psutil.wait_procs(tree, timeout=30)
    assert (len(gone) > 1, alive) == (True, [])
    with machine.logging("serve", "--port", "0") as log:
        assert any(line["event"] == "listening" for line in log)


def test_a_folder_in_which_the_lock_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "data" / "serve.lock").mkdir(parents=True)
    machine = Machine(tmp_path / "home")
    code, _, stderr = machine.run("serve", "--port", "0", "--data", str(tmp_path / "data"))
    said = f"scene-attack: bad input: --data: {tmp_path / 'data' / 'serve.lock'} cannot be written (Is a directory)"
    assert (code, said in stderr) == (2, True), stderr
