"""Files of training data: the images of some scenes, and scenes and questions in CLEVR's own formats."""

import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from numpy.typing import NDArray
from PIL import Image
from safetensors import SafetensorError, safe_open

from services import disk
from services.errors import InvalidRequest
from services.questions.generator import QuestionFile, QuestionRecord
from services.scenes.clevr.records import Info, SceneFile, SceneRecord

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Shard:
    """Some scenes, their images and their questions.

    png: uint8, the files of the images behind each other. ends: int64, where each ends. written: the JSON of scenes and
    questions.
    """

    png: Bytes
    ends: NDArray[np.int64]
    written: dict[str, str]

    def __len__(self) -> int:
        return len(self.ends)

    @cached_property
    def scenes(self) -> tuple[SceneRecord, ...]:
        """The scenes."""
        return SceneFile.model_validate_json(self.written["scenes"]).scenes

    @cached_property
    def questions(self) -> tuple[QuestionRecord, ...]:
        """The questions about all scenes; the scenes' own `image_index` tells them apart."""
        return QuestionFile.model_validate_json(self.written["questions"]).questions

    def image(self, number: int) -> Bytes:
        """Returns the image of a scene, uint8 [240, 320, 3]."""
        start = int(self.ends[number - 1]) if number else 0
        with Image.open(io.BytesIO(self.png[start : self.ends[number]].tobytes())) as file:
            return np.asarray(file)


def shard(scenes: Sequence[SceneRecord], questions: Sequence[QuestionRecord], images: Sequence[Bytes]) -> Shard:
    """Returns the shard of some scenes; `images` are uint8 [240, 320, 3], of the scenes in their order."""
    files = [_png(image) for image in images]
    info = Info(split=scenes[0].split)
    written = {
        "scenes": SceneFile(info=info, scenes=tuple(scenes)).model_dump_json(by_alias=True, exclude_unset=True),
        "questions": QuestionFile(info=info, questions=tuple(questions)).model_dump_json(exclude_unset=True),
    }
    png = np.frombuffer(b"".join(files), np.uint8)
    return Shard(png, np.cumsum([len(file) for file in files], dtype=np.int64), written)


def write(path: Path, made: Shard, about: str) -> None:
    """Writes a shard and, for `read` and `digest` to compare, what it is about."""
    arrays: dict[str, NDArray[Any]] = {"png": made.png, "ends": made.ends}
    metadata = made.written | {"about": about}
    data = safetensors.numpy.save(arrays, metadata | {"sha256": _digest(arrays, metadata)})
    disk.write(path, _in_order(data))


def digest(path: Path, about: str) -> str:
    """Returns the digest that a file has of its contents. Raises InvalidRequest("--out") as `read` does."""
    return _opened(path, about, ())[1]["sha256"]


def read(path: Path, about: str) -> Shard:
    """Reads a file. Raises InvalidRequest("--out") if it is damaged, or about something else."""
    arrays, metadata = _opened(path, about, ("ends", "png"))
    sha256 = metadata.pop("sha256")
    if _digest(arrays, metadata) != sha256:
        raise _damaged(path, "its contents are not those of its digest")
    return Shard(arrays["png"], arrays["ends"], {name: metadata[name] for name in ("scenes", "questions")})


def _opened(path: Path, about: str, wanted: Sequence[str]) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    try:
        with safe_open(path, framework="np") as file:
            metadata = dict(file.metadata() or {})
            arrays = {name: file.get_tensor(name) for name in wanted}
    except (SafetensorError, OSError) as error:
        raise _damaged(path, str(error)) from error
    if missing := {"scenes", "questions", "about", "sha256"} - set(metadata):
        raise _damaged(path, f"it has no {', '.join(sorted(missing))}")
    if metadata["about"] != about:
        raise InvalidRequest("--out", f"{path} has {metadata['about']}, not {about}; move it away")
    return arrays, metadata


def _in_order(file: bytes) -> bytes:
    """Returns a safetensors file with its metadata by name: the library writes them in another order each time."""
    length = int.from_bytes(file[:8], "little")
    header = json.loads(file[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    written = json.dumps(header, separators=(",", ":")).encode()
    written += b" " * (-len(written) % 8)  # the arrays are aligned
    return len(written).to_bytes(8, "little") + written + file[8 + length :]


def _damaged(path: Path, why: str) -> InvalidRequest:
    return InvalidRequest("--out", f"{path} is damaged ({why}); delete it, and it is made anew")


def _digest(arrays: dict[str, NDArray[Any]], metadata: dict[str, str]) -> str:
    found = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name in sorted(arrays):
        found.update(np.ascontiguousarray(arrays[name]).data)
    return found.hexdigest()


def _png(image: Bytes) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()
