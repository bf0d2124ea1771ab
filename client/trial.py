"""Tries what may take a process down: the device, OpenGL, compiled kernels, a network. `checkup` runs it by itself.

Prints a line of JSON for each, as soon as it is known.
"""

import json
import shutil
from collections.abc import Callable

from services.errors import InvalidRequest, JobFailure, printable, summary
from services.pipeline.extensions import set_up
from services.process import options
from services.settings import Settings


def main() -> None:
    """Tries everything; an error of one thing does not keep the others from being tried."""
    set_up(Settings())
    _try("device", _device, "set SCENE_ATTACK_DEVICE to auto or cpu")
    _try("OpenGL", _opengl, "install what it names; SCENE_ATTACK_GL says which platform is tried")
    _try("kernels", _kernels, "install g++, then run scripts/setup")
    _try("default network", _network, "run scripts/setup: its weights come with a package")


def _try(subject: str, attempt: Callable[[], tuple[str, str]], remedy: str) -> None:
    try:
        level, text = attempt()
    except InvalidRequest as error:
        level, text = "fail", f"{error.field}: {error.detail}"
    except JobFailure as error:
        level, text = "fail", error.detail
    except Exception as error:
        level, text = "fail", summary(error)
    said = {"subject": subject, "level": level, "text": printable(text), "remedy": "" if level == "ok" else remedy}
    print(json.dumps(said), flush=True)


def _device() -> tuple[str, str]:
    from services.device import describe, device

    return "ok", describe(device())


def _opengl() -> tuple[str, str]:
    """Makes a context; it draws and reads back once when it is made."""
    from services.rendering.opengl.context import gl_backend

    return "ok", gl_backend()


def _kernels() -> tuple[str, str]:
    from services.rendering.kernels import compiled

    backend = compiled.backend()
    compiler = shutil.which("g++")
    if backend != "torch":
        return "ok", backend
    if options().kernel == "torch":
        return "ok", "torch, as SCENE_ATTACK_KERNEL says"
    return "warn", f"none, so torch does their work some ten times slower; compiler: {compiler or 'none'}"


def _network() -> tuple[str, str]:
    from services.pipeline.spec import DEFAULT_TARGET
    from services.targets import registry

    registry.load(DEFAULT_TARGET)
    return "ok", f"{DEFAULT_TARGET} is loaded"


if __name__ == "__main__":
    main()
