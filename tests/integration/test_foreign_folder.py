"""The commands work in a folder in which a user's own files have the names of our packages."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.conftest import PATIENCE, serving

pytestmark = pytest.mark.integration

SPEC = {
    "scene": {"camera": {"size": [64, 64]}, "objects": [{"mesh": "primitive/sphere"}]},
    "attack": {"renderer": "torch", "steps": 1},
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder. A process of ours that read one of its files would end there."""
    own = tmp_path / "own"
    (own / "api").mkdir(parents=True)
    for name in ("client.py", "services.py", "worker.py", "queue.py", "api/__init__.py"):
        (own / name).write_text("raise SystemExit('this is a file of the user')\n")
    (own / "spec.json").write_text(json.dumps(SPEC))
    monkeypatch.chdir(own)
    return own


def command(*arguments: str) -> "subprocess.CompletedProcess[str]":
    ours = Path(sys.executable).with_name("scene-attack")
    return subprocess.run([ours, *arguments], capture_output=True, text=True, check=False, timeout=PATIENCE)


def test_an_attack_runs_and_the_machine_is_examined(folder: Path) -> None:
    done = command("run", "spec.json", "--out", "result")
    assert (done.returncode, (folder / "result/result.json").exists()) == (0, True), done.stdout + done.stderr
    examined = json.loads(command("doctor", "--json").stdout)
    assert "trial" not in json.dumps(examined), examined


@pytest.mark.usefixtures("folder")
def test_the_service_starts_and_runs_a_job(tmp_path: Path) -> None:
    with serving(tmp_path / "data") as stack:
        assert stack.ended(stack.submit(SPEC))["state"] == "succeeded"
