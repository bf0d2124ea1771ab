"""The process's one OpenGL context: the choice of its platform, and the test that it works.

OpenGL binds to a platform at import, so nothing may import OpenGL or pyrender before `current()` has chosen one; the
modules that do (`render_pass`) are imported from here. There is one context per process, because under EGL deleting one
renderer kills the others, and it belongs to the thread that first asked for it: OpenGL keeps its current context per
thread, and a forked child of a process that has one hangs.

Whether EGL draws here is tried in a process of its own, for a broken driver may take the one that tries it down. The
answer is remembered as long as nothing that it depends on has changed.
"""

import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scene_attack import disk
from scene_attack.errors import JobFailure
from scene_attack.process import options

if TYPE_CHECKING:
    from scene_attack.rendering.opengl.render_pass import FloatRenderer

PROBE_SECONDS = 300.0
"""Time limit of the probe, seconds; a driver that takes longer counts as hanging. On a busy machine a process may take
minutes, and must not choose another platform than on an idle one: their images differ.
"""
PREFIXES = ("EGL", "__EGL", "__GL", "LIBGL", "MESA", "GALLIUM", "LP_", "LD_", "CUDA_VISIBLE", "DISPLAY", "WAYLAND")
"""Prefixes of the environment variables that drivers read."""
FOLDERS = ("/dev/dri", "/usr/share/glvnd/egl_vendor.d", "/etc/glvnd/egl_vendor.d")
"""Folders whose content or times change when a driver or a device is added or removed."""

_PROBE = """
import json
from scene_attack.rendering.opengl import context
print(json.dumps({"device": context.try_egl_devices(), "files": context.loaded()}))
"""


def working_device() -> tuple[str | None, str]:
    """Returns the EGL device that draws and an empty text, or None and the reason why there is none.

    A remembered device is forgotten until `confirm`: if it were wrong and this process died of it, the next would probe
    again.
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
            timeout=PROBE_SECONDS,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return None, str(error)
    if done.returncode == 0:
        report = json.loads(done.stdout.splitlines()[-1])
        _taken.update(report, surroundings=_surroundings())
        return report["device"], ""
    lines = done.stderr.strip().splitlines()
    return None, lines[-1] if lines else f"the probe ended with status {done.returncode}"


def confirm() -> None:
    """Stores the device that `working_device` returned, once it has drawn in this process too."""
    if not _taken:
        return
    disk.write(_path(), json.dumps(_taken).encode())


def loaded() -> dict[str, list[int]]:
    """Returns the shared libraries in this process, those of the driver among them, with size and time of change."""
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
    return options().cache_dir / "egl.json"


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


PLATFORMS = ("egl", "osmesa")
PACKAGES = "install the Debian packages `libegl1 libgl1 libgl1-mesa-dri`, and for OSMesa `libosmesa6`"


@dataclass(frozen=True)
class Context:
    """A current OpenGL context, its renderer, and the process and thread that it belongs to."""

    renderer: "FloatRenderer"
    backend: str
    pid: int
    thread: int

    @property
    def software(self) -> bool:
        """Whether OpenGL runs in software, on the CPU."""
        return "llvmpipe" in self.backend or "softpipe" in self.backend


_context: Context | None = None
_egl_trouble = ""
"""Why `choose_platform` did not take EGL, for the message if OSMesa fails, too."""
_lock = threading.Lock()


def current() -> Context:
    """The process's context, made on first use.

    Raises JobFailure("internal") when no platform works, and when called from another thread than the first call, or
    in a process forked after it.
    """
    global _context
    with _lock:
        if _context is None:
            _context = _create(choose_platform())
            confirm()
    if _context.pid != os.getpid():
        raise JobFailure("internal", "OpenGL was used before this process was forked; start it afresh (spawn) instead")
    if _context.thread != threading.get_ident():
        raise JobFailure("internal", "OpenGL belongs to the thread that used it first; render from that thread only")
    return _context


def owner() -> int | None:
    """The thread that OpenGL belongs to; None before it was used."""
    return None if _context is None else _context.thread


def gl_backend() -> str:
    """Everything of the OpenGL side that decides the bits of an image: platform, driver and library versions."""
    return current().backend


def choose_platform() -> str:
    """Choose "egl" or "osmesa", and tell PyOpenGL (and child processes) through PYOPENGL_PLATFORM and EGL_DEVICE_ID.

    A PYOPENGL_PLATFORM that is already set is kept. Otherwise the setting `gl` decides; "auto" takes EGL if a separate
    process can draw with it (a broken driver may abort the process that tries it), else OSMesa.
    """
    global _egl_trouble
    platform = options().gl
    chosen = os.environ.get("PYOPENGL_PLATFORM")
    if chosen is not None:
        if chosen not in PLATFORMS:
            raise JobFailure("internal", f"PYOPENGL_PLATFORM={chosen!r} cannot draw off screen; use egl or osmesa")
        if platform not in ("auto", chosen):
            raise JobFailure(
                "internal", f"SCENE_ATTACK_GL={platform} contradicts PYOPENGL_PLATFORM={chosen}; unset one"
            )
        return chosen
    if platform != "osmesa":
        device, trouble = working_device()
        if device is not None:
            os.environ["EGL_DEVICE_ID"] = device
            platform = "egl"
        elif platform == "egl":
            raise JobFailure("internal", f"EGL does not work here ({trouble}); {PACKAGES}")
        else:
            platform, _egl_trouble = "osmesa", f"; with egl: {trouble}"
    os.environ["PYOPENGL_PLATFORM"] = platform
    return platform


def try_egl_devices() -> str:
    """The number of the first EGL device that can draw in floating point. Runs in the probe's own process."""
    _set_up_libraries("egl")
    from pyrender.platforms import egl

    device_id = os.environ.get("EGL_DEVICE_ID")
    errors = []
    for device in [device_id] if device_id is not None else [str(i) for i in range(len(egl.query_devices()))]:
        os.environ["EGL_DEVICE_ID"] = device
        try:
            _create("egl")
        except Exception as error:
            errors.append(f"device {device}: {error}")
        else:
            return device
    raise RuntimeError("; ".join(errors) or "no EGL device")


def _load_triton() -> None:
    """Imports Triton, where torch has it. Torch does so itself later, as in the first step of an optimiser, and Triton
    crashes the process if Mesa has brought its LLVM into it before.
    """
    if find_spec("triton") is not None:
        import_module("triton")


def _set_up_libraries(platform: str) -> None:
    """Sets what PyOpenGL and pyglet read when pyrender imports them.

    PyOpenGL must not ask for errors after every call, which takes as long as drawing a small part: `draw` asks once, at
    its end. pyglet, of which pyrender's viewer is made, must not look for X11's libraries: a server may lack them.
    """
    import OpenGL

    os.environ.setdefault("PYGLET_HEADLESS", "true")
    if platform == "egl":
        import OpenGL.EGL  # PyOpenGL cannot import this part without its checks

    OpenGL.ERROR_CHECKING = False


def _create(platform: str) -> Context:
    _load_triton()
    try:
        _set_up_libraries(platform)
        # A 1x1 window surface: everything is drawn into framebuffers of our own.
        if platform == "egl":
            from pyrender.platforms import egl

            device = egl.get_device_by_index(int(os.environ.get("EGL_DEVICE_ID", "0")))
            surface = egl.EGLPlatform(1, 1, device=device)
        else:
            from pyrender.platforms.osmesa import OSMesaPlatform

            surface = OSMesaPlatform(1, 1)
        surface.init_context()
        surface.make_current()
        from scene_attack.rendering.opengl.render_pass import FloatRenderer, describe

        renderer = FloatRenderer(surface)
        renderer.check()
        return Context(renderer, f"{platform} {describe()}", os.getpid(), threading.get_ident())
    except Exception as error:
        raise JobFailure("internal", f"cannot draw with {platform} ({error!r}{_egl_trouble}); {PACKAGES}") from error
