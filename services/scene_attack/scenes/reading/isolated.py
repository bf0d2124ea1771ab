"""Reads files that are not trusted in processes of their own (`scene_attack.scenes.reading.process`), one for each.

The parts of a mesh come back as plain arrays, which are checked on arrival: the bytes are a safetensors file, in which
nothing can be run, with the arrays and a JSON document of the rest. A texture that several parts use is sent once.
"""

import atexit
import json
import os
import socket
import subprocess
import threading
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from safetensors.numpy import load, save

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.logs import logger
from scene_attack.process import program
from scene_attack.scenes.bundle import MAX_FILES, Up, clean_name
from scene_attack.scenes.description import Finite, Unit
from scene_attack.scenes.image_file import MAX_PIXELS
from scene_attack.scenes.mesh import FIT_RADIUS, VERTEX_ATTRIBUTES, AlphaMode, Bytes, Floats, MapName, Part
from scene_attack.scenes.scene_file import SceneFile
from scene_attack.scenes.store import from_arrays, to_arrays

MOST_PHRASES = 40
"""Phrases of each kind; the last says how many more there would be."""
PHRASE_LENGTH = 300
"""Longest phrase."""


class Report(NamedTuple):
    """Report on a mesh: what it shows, what was dropped, and the scene of a file whose format has one."""

    used: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    scene: SceneFile | None = None


def listed(phrases: Iterable[str]) -> tuple[str, ...]:
    """Returns each phrase once, none longer than PHRASE_LENGTH and at most MOST_PHRASES."""
    shown = [
        "".join(c if c.isprintable() else "\ufffd" for c in text[:PHRASE_LENGTH]) for text in dict.fromkeys(phrases)
    ]
    if len(shown) > MOST_PHRASES:
        shown[MOST_PHRASES - 1 :] = [f"and {len(shown) - MOST_PHRASES + 1} more"]
    return tuple(shown)


Arrays = Mapping[str, NDArray[Any]]
Wrap = Literal[10497, 33071, 33648]
Phrase = Annotated[str, Field(max_length=PHRASE_LENGTH)]
_ROUNDING = 1.001


class _Record(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")


class _Material(_Record):
    metallic: Unit
    roughness: Unit
    emissive: tuple[Unit, Unit, Unit]
    alpha_mode: AlphaMode
    alpha_cutoff: Annotated[Finite, Field(ge=0)]
    double_sided: bool
    normal_scale: Finite
    occlusion_strength: Unit
    given: bool
    maps: dict[MapName, tuple[Literal[0, 1], tuple[Wrap, Wrap]]]


class _Document(_Record):
    parts: Annotated[int, Field(ge=1)]
    materials: dict[str, _Material]
    """The settings of materials, by the names that they have among the arrays."""
    same: dict[str, str]
    """The names of arrays that are sent once under another name."""
    used: Annotated[list[Phrase], Field(max_length=MOST_PHRASES)]
    dropped: Annotated[list[Phrase], Field(max_length=MOST_PHRASES)]
    scene: SceneFile | None = None


def pack(parts: tuple[Part, ...], report: Report) -> bytes:
    """Returns the parts of a mesh and what became of its files as bytes for `unpack`."""
    arrays = to_arrays(parts)
    texts = [name for name, array in arrays.items() if array.dtype.kind == "U"]
    materials = {name: _Material.model_validate_json(str(arrays.pop(name))) for name in texts}
    first: dict[int, str] = {}
    same = {name: first.setdefault(id(array), name) for name, array in arrays.items()}
    document = _Document(
        parts=len(parts),
        materials=materials,
        same={name: sent for name, sent in same.items() if name != sent},
        used=list(report.used),
        dropped=list(report.dropped),
        scene=report.scene,
    )
    sent = {name: np.ascontiguousarray(arrays[name]) for name in first.values()}
    return save(sent | {"document": np.frombuffer(document.model_dump_json().encode(), np.uint8)})


def unpack(data: bytes, max_faces: int) -> tuple[tuple[Part, ...], Report]:
    """Returns what `pack` was given. The sender is not trusted.

    Raises ValueError if an array or a setting is missing, has another shape or type than `Part` says, has numbers that
    are not finite or out of range, or if there are more than `max_faces` triangles.
    """
    arrays = _load(data)
    document = _Document.model_validate_json(_array(arrays, "document", np.uint8, None).tobytes())
    del arrays["document"]
    if sum(array.size for array in arrays.values() if array.ndim == 3) > 4 * MAX_PIXELS:
        raise ValueError("it has too many texels")
    arrays |= {name: arrays[sent] for name, sent in document.same.items() if sent in arrays}
    triangles = 0
    for k in range(document.parts):
        _check_part(arrays, k, document.materials.get(f"{k}.metallic_roughness"))
        triangles += len(arrays[f"{k}.faces"])
    if triangles > max_faces:
        raise ValueError(f"it has more than {max_faces:,} triangles")
    if document.scene is not None and not document.scene.unusable and len(document.scene.parts) != document.parts:
        raise ValueError("its scene has other parts")
    texts = {name: np.array(material.model_dump_json()) for name, material in document.materials.items()}
    try:
        return from_arrays(arrays | texts), Report(tuple(document.used), tuple(document.dropped), document.scene)
    except (KeyError, TypeError) as error:
        raise ValueError(f"an array is missing, or belongs to no part: {error}") from error


def _load(data: bytes) -> dict[str, NDArray[Any]]:
    try:
        return dict(load(data))
    except Exception as error:  # safetensors has a class of its own, which is no ValueError
        raise ValueError(f"it is no safetensors file: {error}") from error


def _array(arrays: Arrays, name: str, kind: type[np.generic], *shape: int | None) -> NDArray[Any]:
    """Returns an array of a type and shape, in which None is any length of at least 1, with finite values."""
    array = arrays.get(name)
    if array is None or array.dtype != kind or array.ndim != len(shape):
        raise ValueError(f"{name} is not there, or is no array of {len(shape)} dimensions of {kind.__name__}")
    if any(length == 0 or expected not in (None, length) for length, expected in zip(array.shape, shape, strict=True)):
        raise ValueError(f"{name} has the shape {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{name} has values that are not finite numbers")
    return array


def _check_part(arrays: Arrays, k: int, material: _Material | None) -> None:
    vertices = _array(arrays, f"{k}.vertices", np.float32, None, 3)
    normals = _array(arrays, f"{k}.normals", np.float32, len(vertices), 3)
    faces = _array(arrays, f"{k}.faces", np.int32, None, 3)
    color = _array(arrays, f"{k}.color", np.float32, 4)
    if faces.min() < 0 or faces.max() >= len(vertices) or len(vertices) > faces.size:
        raise ValueError(f"{k}.faces name other vertices than there are")
    for name, values, most in (("vertices", vertices, FIT_RADIUS), ("normals", normals, 1.0)):
        if float(np.square(values, dtype=np.float64).sum(axis=1).max()) > (most * _ROUNDING) ** 2:
            raise ValueError(f"{k}.{name} are longer than {most:g}")
    if color.min() < 0 or color.max() > 1:
        raise ValueError(f"{k}.color is not in [0,1]")
    if f"{k}.uv" in arrays:
        _array(arrays, f"{k}.uv", np.float32, len(vertices), 2)
    if f"{k}.texture" in arrays:
        _array(arrays, f"{k}.texture", np.uint8, None, None, 4)
    if material is not None:
        for name, columns in VERTEX_ATTRIBUTES.items():
            _array(arrays, f"{k}.metallic_roughness.{name}", np.float32, len(vertices), columns)
        for name in material.maps:
            _array(arrays, f"{k}.metallic_roughness.{name}", np.uint8, None, None, 4)


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
        """Returns the texels of an environment map, as `environment.read_map` does: float32 [h,w,3], finite and ≥ 0.

        Raises InvalidRequest("file", …), and JobFailure("internal") if no process can be started.
        """
        reply, payload = self._ask({"map": kind}, data)
        try:
            height, width = reply["size"]
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
        reply, payload = self._ask({"archive": most}, data)
        try:
            return split(reply["files"], payload, most)
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
                for chunk in data:
                    ours.sendall(chunk)
                ours.shutdown(socket.SHUT_WR)
                answer = _received(ours)
            except (OSError, ValueError) as error:  # the child was killed, or says more than it may
                raise InvalidRequest(_field(request), _GONE) from error
        head, _, payload = answer.partition(b"\n")
        try:
            reply = json.loads(head)
            refused = (str(reply["field"]), str(reply["detail"])) if "field" in reply else None
        except (ValueError, TypeError, KeyError) as error:
            raise InvalidRequest(_field(request), _GONE) from error
        if refused is not None:
            raise InvalidRequest(*refused)
        return reply, payload

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
                program("scene_attack.scenes.reading.process", str(theirs.fileno())),
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
            started = json.loads(ours.recv(2**16))
        except (OSError, ValueError) as error:
            self._end()
            raise JobFailure("internal", "the process that reads files does not start; the log says why") from error
        for sentence in started["missing"]:
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
    """Returns this process's reader, which ends with this process."""
    started = IsolatedReader()
    atexit.register(started.close)
    return started


def split(files: list[Any], payload: bytes, most: int) -> dict[str, bytes]:
    """Returns the files of names and lengths that follow each other in `payload`. Raises ValueError or TypeError."""
    split_files: dict[str, bytes] = {}
    start = 0
    if len(files) > MAX_FILES or len(payload) > most:
        raise ValueError("there is more than was asked for")
    for name, length in files:
        if not isinstance(length, int) or length < 0 or name in split_files or clean_name(name) != name:
            raise ValueError(f"{name!r} of {length!r} bytes is no file")
        split_files[name] = payload[start : start + length]
        start += length
    if start != len(payload):
        raise ValueError("the files are not as long as they are said to be")
    return split_files


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
    """Environment variables with which Python finds the project; numpy's threads would not survive a fork."""
    project = Path(__file__).parents[3]
    return {"PYTHONPATH": os.fspath(project), "PYTHONUTF8": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
