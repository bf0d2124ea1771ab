"""Blender's process (`scene_attack_blender.cycles`): one for all renderers of this process, from the first image on.

A Blender that crashes, is killed or hangs is started again, once for an image, which then is the same: nothing but the
scene and the frame decides it. If it fails again the job ends with a reason.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from scene_attack.errors import JobFailure
from scene_attack.logs import logger
from scene_attack.process import program

STILL_SECONDS = 60.0
"""Longest time without a sign of life, after which Blender is killed: at work it gives many a second."""
ENDING_SECONDS = 5.0
"""Longest wait for the end of a process whose connection is closed."""
ERRORS = "errors"
"""File in the process's folder with what Blender and Python print of errors."""

FOLDER = "scene-attack-blender-"
"""Beginning of the name of the process's folder; the number of the process that started it follows."""

log = logger(__name__)


@dataclass(frozen=True, eq=False)
class StagedScene:
    """A scene as `scene_attack_blender.cycles.Stage` takes it: its description, and arrays by name."""

    described: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]


class BlenderProcess:
    """The parent's end of Blender's process. Safe to share between threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._stream: IO[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._staged: StagedScene | None = None

    @property
    def pid(self) -> int | None:
        """The process's number; None while there is none."""
        return None if self._process is None else self._process.pid

    def image(self, scene: StagedScene, frame: Mapping[str, Any]) -> NDArray[np.float32]:
        """Returns the image of a frame as `cycles.Stage.render` makes it, float32 [H·W·4]. The scene is sent if the
        process has another one.

        Raises JobFailure: "out-of-memory", "timeout" for a Blender that hangs, "internal" for one that ends; each only
        if a new process fails too.
        """
        with self._lock:
            for last in (False, True):
                try:
                    self._stage(scene)
                    return np.frombuffer(self._ask({"frame": frame}), np.float32)
                except JobFailure as failure:
                    self._end()
                    if last:
                        raise
                    log.warning("Blender is started again", detail=failure.detail)
        raise AssertionError

    def close(self) -> None:
        """Ends the process, if there is one."""
        with self._lock:
            self._end()

    def _stage(self, scene: StagedScene) -> None:
        if self._stream is None:
            self._start()
        if self._staged is not scene:
            self._staged = None
            self._ask({"scene": scene.described}, scene.arrays)
            self._staged = scene

    def _start(self) -> None:
        ours, theirs = socket.socketpair()
        _remove_left_folders()
        self._folder = tempfile.TemporaryDirectory(prefix=f"{FOLDER}{os.getpid()}-")
        with theirs, Path(self._folder.name, ERRORS).open("wb") as errors:
            self._process = subprocess.Popen(
                program("scene_attack_blender.cycles", str(theirs.fileno()), self._folder.name),
                pass_fds=[theirs.fileno()],
                env=environment(self._folder.name),
                cwd="/",
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=errors,
            )
        ours.settimeout(STILL_SECONDS)
        self._connection, self._stream = ours, ours.makefile("rb")

    def _ask(self, message: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]] | None = None) -> bytes:
        """Sends a message and returns the bytes of its answer. Raises JobFailure."""
        data = {name: np.ascontiguousarray(array).tobytes() for name, array in (arrays or {}).items()}
        sizes = [(name, len(content)) for name, content in data.items()]
        assert self._connection is not None
        assert self._stream is not None
        try:
            self._connection.sendall(json.dumps({**message, "arrays": sizes}).encode() + b"\n")
            for content in data.values():
                self._connection.sendall(content)
            while (line := self._stream.readline()) == b"\n":
                pass  # Blender is at work
            answer = json.loads(line)
            if "error" not in answer:
                payload = self._stream.read(answer["bytes"])
                if len(payload) == answer["bytes"]:
                    return payload
        except TimeoutError as error:
            detail = f"Blender did nothing for {STILL_SECONDS:g} seconds, and was ended"
            raise JobFailure("timeout", detail) from error
        except (OSError, ValueError) as error:
            raise self._failure() from error
        if "error" in answer:
            kind = "out-of-memory" if answer["memory"] else "internal"
            raise JobFailure(kind, f"Blender raised {answer['error']}")
        raise self._failure()

    def _failure(self) -> JobFailure:
        """Why the process has closed its connection."""
        assert self._process is not None
        assert self._folder is not None
        try:
            code = self._process.wait(ENDING_SECONDS)
        except subprocess.TimeoutExpired:
            return JobFailure("internal", "Blender closed its connection, and was ended")
        return ended(code, Path(self._folder.name, ERRORS).read_text("utf-8", "replace"))

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        for held in (self._stream, self._connection):
            if held is not None:
                held.close()
        if self._folder is not None:
            self._folder.cleanup()
        self._process = self._stream = self._connection = self._folder = self._staged = None


def _remove_left_folders() -> None:
    """Removes the folders of processes that were killed, and so left theirs."""
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER}*"):
        owner = folder.name.removeprefix(FOLDER).partition("-")[0]
        with suppress(ValueError, PermissionError):  # of another program, or another user's
            try:
                os.kill(int(owner), 0)
            except ProcessLookupError:
                shutil.rmtree(folder, ignore_errors=True)


def ended(code: int, printed: str) -> JobFailure:
    """Why a process of Blender's ended with a code, by what it printed of errors."""
    last = printed.strip().rpartition("\n")[2]
    if "bad_alloc" in printed or "MemoryError" in last:
        return JobFailure("out-of-memory", "Blender ran out of memory")
    if code < 0:
        name = signal.Signals(-code).name
        why = ", as the system does to a process when memory runs out" if code == -signal.SIGKILL else ""
        return JobFailure("internal", f"Blender was ended by the signal {name}{why}")
    return JobFailure("internal", f"Blender ended with code {code}: {last}")


@lru_cache(maxsize=1)
def blender() -> BlenderProcess:
    """Returns this process's Blender, which the kernel ends with this process."""
    return BlenderProcess()


def environment(folder: str) -> dict[str, str]:
    """Environment variables with which Python finds the project, and Blender no folder of a user or a site."""
    project = os.fspath(Path(__file__).parents[1])
    return {
        "PYTHONPATH": project,
        "PYTHONUTF8": "1",
        "HOME": folder,
        "TMPDIR": folder,
        "BLENDER_USER_RESOURCES": folder,
    }
