"""Reads files that are not trusted in processes of their own, one for each file (`services.scenes.reading.process`).

The parts of a mesh come back as plain arrays, which are checked on arrival: the bytes are a safetensors file, in which
nothing can be run, with the arrays and a JSON document of the rest. A texture that several parts use is sent once.
"""

import atexit
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from safetensors.numpy import load, save

import services
from services.errors import InvalidRequest, JobFailure
from services.logs import logger
from services.scenes.bundle import MAX_FILES, Up, clean_name
from services.scenes.image_file import MAX_PIXELS
from services.scenes.mesh import (
    FIT_RADIUS,
    VERTEX_ATTRIBUTES,
    AlphaMode,
    Bytes,
    Floats,
    MapName,
    MetallicRoughness,
    Part,
    TextureMap,
)

MOST_PHRASES = 40
"""Phrases of each kind; the last says how many more there would be."""
PHRASE_LENGTH = 300
"""Longest phrase."""


class Report(NamedTuple):
    """Report on a mesh: what it shows, and what was dropped."""

    used: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()


def listed(phrases: Iterable[str]) -> tuple[str, ...]:
    """Returns each phrase once, none longer than PHRASE_LENGTH and at most MOST_PHRASES."""
    shown = [
        "".join(c if c.isprintable() else "\ufffd" for c in text[:PHRASE_LENGTH]) for text in dict.fromkeys(phrases)
    ]
    if len(shown) > MOST_PHRASES:
        shown[MOST_PHRASES - 1 :] = [f"and {len(shown) - MOST_PHRASES + 1} more"]
    return tuple(shown)


Arrays = Mapping[str, NDArray[Any]]
Unit = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Index = Annotated[int, Field(ge=0)]
Phrase = Annotated[str, Field(max_length=PHRASE_LENGTH)]
_ROUNDING = 1.001


class _Record(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")


class _Map(_Record):
    texels: Index
    uv_set: Literal[0, 1]
    wrap: Annotated[list[Literal[10497, 33071, 33648]], Field(min_length=2, max_length=2)]


class _Material(_Record):
    metallic: Unit
    roughness: Unit
    emissive: Annotated[list[Unit], Field(min_length=3, max_length=3)]
    alpha_mode: AlphaMode
    alpha_cutoff: Annotated[Finite, Field(ge=0)]
    double_sided: bool
    normal_scale: Finite
    occlusion_strength: Unit
    maps: dict[MapName, _Map]


class _Part(_Record):
    uv: bool
    texels: Index | None
    material: _Material | None


class _Document(_Record):
    parts: Annotated[list[_Part], Field(min_length=1)]
    used: Annotated[list[Phrase], Field(max_length=MOST_PHRASES)]
    dropped: Annotated[list[Phrase], Field(max_length=MOST_PHRASES)]


def pack(parts: tuple[Part, ...], report: Report) -> bytes:
    """Returns the parts of a mesh and what became of its files as bytes for `unpack`."""
    arrays: dict[str, NDArray[Any]] = {}
    textures: dict[int, int] = {}

    def texels(array: NDArray[Any]) -> int:
        number = textures.setdefault(id(array), len(textures))
        arrays[f"texels.{number}"] = array
        return number

    records = []
    for k, part in enumerate(parts):
        own = part.metallic_roughness
        fields = {name: getattr(part, name) for name in ("vertices", "normals", "faces", "color", "uv")}
        fields |= {} if own is None else {name: getattr(own, name) for name in VERTEX_ATTRIBUTES}
        arrays |= {f"{k}.{name}": array for name, array in fields.items() if array is not None}
        texture = None if part.texture is None else texels(part.texture)
        material = None if own is None else _material_record(own, texels)
        records.append(_Part(uv=part.uv is not None, texels=texture, material=material))
    document = _Document(parts=records, used=list(report.used), dropped=list(report.dropped)).model_dump_json().encode()
    arrays["document"] = np.frombuffer(document, np.uint8)
    return save({name: np.ascontiguousarray(array) for name, array in arrays.items()})


def unpack(data: bytes, max_faces: int) -> tuple[tuple[Part, ...], Report]:
    """Returns what `pack` was given. The sender is not trusted.

    Raises ValueError if an array or a setting is missing, has another shape or type than `Part` says, has numbers that
    are not finite or out of range, or if there are more than `max_faces` triangles.
    """
    arrays = _load(data)
    document = _Document.model_validate_json(_array(arrays, "document", np.uint8, None).tobytes())
    textures = [
        _array(arrays, f"texels.{k}", np.uint8, None, None, 4) for k in range(len(arrays)) if f"texels.{k}" in arrays
    ]
    if sum(texture.size for texture in textures) > 4 * MAX_PIXELS:
        raise ValueError("it has too many texels")
    parts = tuple(_part(arrays, k, record, textures) for k, record in enumerate(document.parts))
    if sum(len(part.faces) for part in parts) > max_faces:
        raise ValueError(f"it has more than {max_faces:,} triangles")
    return parts, Report(tuple(document.used), tuple(document.dropped))


def _load(data: bytes) -> Arrays:
    try:
        return load(data)
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


def _part(arrays: Arrays, k: int, record: _Part, textures: list[NDArray[Any]]) -> Part:
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
    return Part(
        vertices=vertices,
        normals=normals,
        faces=faces,
        uv=_array(arrays, f"{k}.uv", np.float32, len(vertices), 2) if record.uv else None,
        color=color,
        texture=None if record.texels is None else _texture(textures, record.texels),
        metallic_roughness=None if record.material is None else _material(arrays, k, record.material, textures),
    )


def _material_record(material: MetallicRoughness, texels: Callable[[NDArray[Any]], int]) -> _Material:
    fields = {name: getattr(material, name) for name in _Material.model_fields if name not in ("maps", "emissive")}
    maps = {
        name: _Map.model_validate(
            {"texels": texels(texture.texels), "uv_set": texture.uv_set, "wrap": list(texture.wrap)}
        )
        for name, texture in material.maps.items()
    }
    return _Material(**fields, emissive=list(material.emissive), maps=maps)


def _material(arrays: Arrays, k: int, record: _Material, textures: list[NDArray[Any]]) -> MetallicRoughness:
    count = len(arrays[f"{k}.vertices"])
    fields = {name: getattr(record, name) for name in _Material.model_fields if name not in ("maps", "emissive")}
    attributes: dict[str, Any] = {
        name: _array(arrays, f"{k}.{name}", np.float32, count, width) for name, width in VERTEX_ATTRIBUTES.items()
    }
    red, green, blue = record.emissive
    maps = {
        name: TextureMap(_texture(textures, texture.texels), texture.uv_set, (texture.wrap[0], texture.wrap[1]))
        for name, texture in record.maps.items()
    }
    return MetallicRoughness(**fields, **attributes, emissive=(red, green, blue), maps=maps)


def _texture(textures: list[NDArray[Any]], number: int) -> NDArray[Any]:
    if number >= len(textures):
        raise ValueError(f"there is no texels.{number}")
    return textures[number]


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
                [sys.executable, "-m", "services.scenes.reading.process", str(theirs.fileno())],
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
    project = Path(services.__file__).parents[1]
    return {"PYTHONPATH": os.fspath(project), "PYTHONUTF8": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
