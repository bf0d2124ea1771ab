"""Reads files that are not trusted in processes of their own, one for each file (`services.scenes.reading_process`)."""

import atexit
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

import services
from services.errors import InvalidRequest, JobFailure
from services.logs import logger
from services.scenes.about import Up
from services.scenes.bundle import MAX_FILES, clean_name
from services.scenes.mesh import Bytes, Floats, Part
from services.scenes.part_arrays import unpack
from services.scenes.phrases import Report

START_SECONDS = 120.0
ANSWER_SECONDS = 100.0
"""Longest wait for a child, which is killed before that."""
AT_ONCE = 2
"""Files that the API has read at the same time."""
FILE_BYTES = 3 * 2**30
"""Address space of a child beyond what its server has. A grey texture of 16 bits and 2²⁶ pixels takes 2 GB."""
READING_BYTES = AT_ONCE * FILE_BYTES
"""Largest sum of the children's memory."""
MAX_ANSWER = 2**30
"""Largest answer, bytes."""
_GONE = "it is damaged, or could not be read within the time and the memory that reading a file may take"

log = logger(__name__)


class IsolatedReader:
    """The parent's end of a reading process, which starts with the first file. Safe to share between threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._server: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    def read_mesh(
        self,
        data: bytes,
        kind: str,
        max_faces: int,
        others: Mapping[str, bytes] = MappingProxyType({}),
        up: Up | None = None,
    ) -> tuple[tuple[Part, ...], Report]:
        """Returns the parts of a mesh file, as `reading.read_mesh` does, and what became of it and the `others`.

        Raises InvalidRequest("kind" or "file", …), and JobFailure("internal") if no process can be started.
        """
        files = [[name, len(other)] for name, other in others.items()]
        request = {"mesh": kind, "max_faces": max_faces, "up": up, "files": files}
        _, payload = self._ask(request, *others.values(), data)
        try:
            return unpack(payload, max_faces)
        except ValueError as error:
            log.error("a reading process gave an answer that is no mesh", error=str(error))
            raise InvalidRequest("file", _GONE) from error

    def read_map(self, data: bytes, kind: str) -> Floats:
        """Returns the texels of an environment map, as `map_file.read_map` does: float32 [h,w,3], finite and ≥ 0.

        Raises InvalidRequest("file", …), and JobFailure("internal") if no process can be started.
        """
        said, payload = self._ask({"map": kind}, data)
        try:
            height, width = said["size"]
            texels = np.frombuffer(payload, np.float32).reshape(height, width, 3)
        except (ValueError, TypeError, KeyError) as error:
            raise InvalidRequest("file", _GONE) from error
        if not (np.isfinite(texels).all() and (texels >= 0).all()):
            raise InvalidRequest("file", _GONE)
        return texels

    def unpack(self, data: bytes, most: int) -> dict[str, bytes]:
        """Returns the files of a zip file, as `archive.unpack_archive` does: relative paths, and at most `most` bytes.

        Raises InvalidRequest("file", …), and JobFailure("internal") if no process can be started.
        """
        said, payload = self._ask({"archive": most}, data)
        try:
            return split(said["files"], payload, most)
        except (ValueError, TypeError, KeyError) as error:
            log.error("a reading process gave an answer that is no list of files", error=str(error))
            raise InvalidRequest("file", _GONE) from error

    def read_image(self, data: bytes, size: tuple[int, int]) -> Bytes:
        """Returns an image as uint8 [H, W, 3], whose height and width must be `size`.

        Raises InvalidRequest("image", …), and JobFailure("internal") if no process can be started.
        """
        _, payload = self._ask({"image": size}, data)
        if len(payload) != size[0] * size[1] * 3:
            raise InvalidRequest("image", _GONE)
        return np.frombuffer(payload, np.uint8).reshape(*size, 3)

    def start(self) -> None:
        """Starts the server, which takes about a second. Raises JobFailure("internal")."""
        with self._lock:
            self._connected()

    def close(self) -> None:
        """Ends the server and its children."""
        with self._lock:
            self._end()

    def _ask(self, request: dict[str, Any], *data: bytes) -> tuple[dict[str, Any], bytes]:
        """Returns the object and the bytes that a child answers a request with. Raises InvalidRequest as it does."""
        ours, theirs = socket.socketpair()
        with ours:
            ours.settimeout(ANSWER_SECONDS)
            with theirs:
                self._hand_over(theirs)
            try:
                ours.sendall(json.dumps(request).encode() + b"\n")
                for one in data:
                    ours.sendall(one)
                ours.shutdown(socket.SHUT_WR)
                answer = _received(ours)
            except (OSError, ValueError) as error:  # the child was killed, or says more than it may
                raise InvalidRequest(_field(request), _GONE) from error
        head, _, payload = answer.partition(b"\n")
        try:
            said = json.loads(head)
            refused = (str(said["field"]), str(said["detail"])) if "field" in said else None
        except (ValueError, TypeError, KeyError) as error:
            raise InvalidRequest(_field(request), _GONE) from error
        if refused is not None:
            raise InvalidRequest(*refused)
        return said, payload

    def _hand_over(self, end: socket.socket) -> None:
        """Gives the server the child's end of a connection; a server that has died is started again."""
        with self._lock:
            for last in (False, True):
                try:
                    socket.send_fds(self._connected(), [b"+"], [end.fileno()])
                    return
                except OSError as error:
                    self._end()
                    if last:
                        raise JobFailure("internal", "the process that reads files does not start") from error

    def _connected(self) -> socket.socket:
        if self._control is not None:
            return self._control
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._server = subprocess.Popen(
                [sys.executable, "-m", "services.scenes.reading_process", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                env=_environment(),
                cwd="/",
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._control = ours
        ours.settimeout(START_SECONDS)
        try:
            said = json.loads(ours.recv(2**16))
        except (OSError, ValueError) as error:
            self._end()
            raise JobFailure("internal", "the process that reads files does not start; the log says why") from error
        for sentence in said["missing"]:
            log.warning("files are read with less isolation", detail=sentence)
        return ours

    def _end(self) -> None:
        if self._control is not None:
            self._control.close()
        if self._server is not None:
            try:
                self._server.wait(5)
            except subprocess.TimeoutExpired:
                self._server.kill()
                self._server.wait()
        self._control = self._server = None


@lru_cache(maxsize=1)
def reader() -> IsolatedReader:
    """This process's reader. It ends with this process."""
    found = IsolatedReader()
    atexit.register(found.close)
    return found


def split(files: list[Any], payload: bytes, most: int) -> dict[str, bytes]:
    """Returns the files of names and lengths that follow each other in `payload`. Raises ValueError or TypeError."""
    found: dict[str, bytes] = {}
    start = 0
    if len(files) > MAX_FILES or len(payload) > most:
        raise ValueError("there is more than was asked for")
    for name, length in files:
        if not isinstance(length, int) or length < 0 or name in found or clean_name(name) != name:
            raise ValueError(f"{name!r} of {length!r} bytes is no file")
        found[name] = payload[start : start + length]
        start += length
    if start != len(payload):
        raise ValueError("the files are not as long as they are said to be")
    return found


def _received(connection: socket.socket) -> bytes:
    pieces, size = [], 0
    while piece := connection.recv(2**20):
        pieces.append(piece)
        size += len(piece)
        if size > MAX_ANSWER:
            raise ValueError("the answer is too long")
    return b"".join(pieces)


def _field(request: dict[str, Any]) -> str:
    return "image" if "image" in request else "file"


def _environment() -> dict[str, str]:
    """What Python needs to find the project; numpy's threads would not survive a fork."""
    project = Path(services.__file__).parents[1]
    return {"PYTHONPATH": os.fspath(project), "PYTHONUTF8": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
