import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[4]
_START = """
from scene_attack.process import use
from scene_attack.rendering.opengl import context
from scene_attack_service.settings import Settings
use(Settings())
run = context.subprocess.run
probes = []
context.subprocess.run = lambda *a, **k: probes.append(1) or run(*a, **k)
{before}
platform = context.choose_platform()
{between}
context.current()
print(len(probes), platform, context.gl_backend().split()[0])
"""


def start(cache: Path, before: str = "", between: str = "", **environment: str) -> str:
    """How many probes a new process makes, and what it draws with."""
    kept = {k: v for k, v in os.environ.items() if k not in ("PYOPENGL_PLATFORM", "EGL_DEVICE_ID", "SCENE_ATTACK_GL")}
    done = subprocess.run(
        [sys.executable, "-c", _START.format(before=before, between=between)],
        env=kept | {"PYTHONPATH": str(ROOT), "SCENE_ATTACK_CACHE": str(cache)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout.strip() or f"status {done.returncode}"


@pytest.fixture(scope="module")
def memory(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What a process that found a good device remembers of it."""
    cache = tmp_path_factory.mktemp("cache")
    assert start(cache) == "1 egl egl"
    return (cache / "egl.json").read_text()


@pytest.fixture
def known(memory: str, tmp_path: Path) -> Path:
    """A cache in which a good device is remembered."""
    (tmp_path / "egl.json").write_text(memory)
    return tmp_path


def test_a_device_that_drew_is_not_probed_again(known: Path) -> None:
    assert start(known) == "0 egl egl"
    assert start(known) == "0 egl egl"


def test_what_a_driver_looks_at_matters(known: Path) -> None:
    assert start(known, LP_NUM_THREADS="1") == "1 egl egl"


def test_a_library_that_changed_is_probed(known: Path) -> None:
    memory = json.loads((known / "egl.json").read_text())
    drivers = [file for file in memory["files"] if "EGL" in file or "/dri/" in file]
    assert drivers  # the driver's own files are among those that are watched
    memory["files"][drivers[0]][1] += 1
    (known / "egl.json").write_text(json.dumps(memory))
    assert start(known) == "1 egl egl"


@pytest.mark.parametrize("text", ["[", '{"surroundings": 1}'])
def test_a_spoilt_memory_is_none(known: Path, text: str) -> None:
    (known / "egl.json").write_text(text)
    assert start(known) == "1 egl egl"


def test_a_process_that_dies_drawing_leaves_no_memory(known: Path) -> None:
    assert start(known, between="import os; os.abort()") == "status -6"
    assert start(known) == "1 egl egl"
