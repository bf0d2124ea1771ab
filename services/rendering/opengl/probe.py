"""Does EGL draw here? A process of its own finds out, for a broken driver may take the one that tries it down; and what
it found is remembered as long as nothing that it depends on has changed.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from services import atomic_write
from services.process import options

SECONDS = 300.0
"""Time after which a driver hangs. On a busy machine a process may take minutes, and must not draw otherwise than on an
idle one: the images of another platform differ.
"""
PREFIXES = ("EGL", "__EGL", "__GL", "LIBGL", "MESA", "GALLIUM", "LP_", "LD_", "CUDA_VISIBLE", "DISPLAY", "WAYLAND")
"""Prefixes of the environment variables that drivers read."""
FOLDERS = ("/dev/dri", "/usr/share/glvnd/egl_vendor.d", "/etc/glvnd/egl_vendor.d")
"""Where a driver or a device that comes or goes shows."""

_PROBE = """
import json
from services.rendering.opengl import context
from services.rendering.opengl import probe
print(json.dumps({"device": context.try_egl_devices(), "files": probe.loaded()}))
"""


def working_device() -> tuple[str | None, str]:
    """The EGL device that draws, or None and why there is none.

    The memory of it is taken away until `confirm`: were it wrong, and this process died of it, the next would probe.
    """
    remembered = _take()
    if remembered is not None:
        return remembered["device"], ""
    environment = os.environ | {"PYOPENGL_PLATFORM": "egl", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env=environment,
            capture_output=True,
            text=True,
            timeout=SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return None, str(error)
    if done.returncode == 0:
        found = json.loads(done.stdout.splitlines()[-1])
        _taken.update(found, surroundings=_surroundings())
        return found["device"], ""
    lines = done.stderr.strip().splitlines()
    return None, lines[-1] if lines else f"the probe ended with status {done.returncode}"


def confirm() -> None:
    """Remember the device that `working_device` gave: it draws in this process too."""
    if not _taken:
        return
    atomic_write.write(_path(), json.dumps(_taken).encode())


def loaded() -> dict[str, list[int]]:
    """The shared libraries in this process, with size and time of change: those of the driver among them."""
    lines = Path("/proc/self/maps").read_text("utf-8").splitlines()
    paths = {line.split(maxsplit=5)[5] for line in lines if ".so" in line and "/" in line}
    return {path: stamp for path in sorted(paths) if (stamp := _stamp(path)) is not None}


_taken: dict[str, Any] = {}


def _take() -> dict[str, Any] | None:
    path = _path()
    try:
        text = path.read_text("utf-8")
        path.unlink()
        memory = json.loads(text)
        if memory["surroundings"] != _surroundings():
            return None
        if any(_stamp(file) != stamp for file, stamp in memory["files"].items()):
            return None
        _taken.update(memory)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None  # none, someone else's at the moment, or not ours: probe
    return _taken


def _path() -> Path:
    return options().cache / "egl.json"


def _surroundings() -> list[object]:
    """Everything that a driver may read beside its own files: machine, interpreter, variables, folders of devices."""
    machine = os.uname()
    variables = {name: value for name, value in sorted(os.environ.items()) if name.startswith(PREFIXES)}
    folders = [sorted(p.name for p in Path(f).iterdir()) if Path(f).is_dir() else None for f in FOLDERS]
    return [machine.nodename, machine.release, machine.version, sys.executable, variables, folders]


def _stamp(path: str) -> list[int] | None:
    try:
        state = os.stat(path)
    except OSError:
        return None
    return [state.st_size, state.st_mtime_ns]
