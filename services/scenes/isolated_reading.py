"""Reads files that are not trusted in processes of their own, one for each file (`services.scenes.reading_process`)."""

import atexit
import json
import os
import socket
import subprocess
import sys
import threading
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import services
from services.errors import InvalidRequest, JobFailure
from services.logs import logger
from services.scenes.mesh import Bytes, Part
from services.scenes.part_arrays import unpack

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
_GONE = "it could not be read within the time and the memory that reading a file may take"

log = logger(__name__)


class IsolatedReader:
    """The parent's end of a reading process, which starts with the first file. Safe to share between threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._server: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    def read_mesh(self, data: bytes, kind: str, max_faces: int) -> tuple[tuple[Part, ...], tuple[str, ...]]:
        """Returns the parts of a mesh file, as `reading.read_mesh` does, and what it lacks, in sentences.

        Raises InvalidRequest("kind" or "file", …), and JobFailure("internal") if no process can be started.
        """
        payload = self._ask({"mesh": kind, "max_faces": max_faces}, data)
        try:
            return unpack(payload, max_faces)
        except ValueError as error:
            log.error("a reading process gave an answer that is no mesh", error=str(error))
            raise InvalidRequest("file", _GONE) from error

    def read_image(self, data: bytes, size: tuple[int, int]) -> Bytes:
        """Returns an image as uint8 [H, W, 3], whose height and width must be `size`.

        Raises InvalidRequest("image", …), and JobFailure("internal") if no process can be started.
        """
        payload = self._ask({"image": size}, data)
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

    def _ask(self, request: dict[str, Any], data: bytes) -> bytes:
        """Returns the bytes that a child answers a request with. Raises InvalidRequest as the child does."""
        ours, theirs = socket.socketpair()
        with ours:
            ours.settimeout(ANSWER_SECONDS)
            with theirs:
                self._hand_over(theirs)
            try:
                ours.sendall(json.dumps(request).encode() + b"\n")
                ours.sendall(data)
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
        return payload

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
