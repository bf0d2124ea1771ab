"""The artifact store: files of results under the hash of their bytes."""

import hashlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

MEDIA_TYPES = {".json": "application/json", ".png": "image/png"}
"""By file name ending; everything else, safetensors too, is plain bytes."""


@dataclass(frozen=True)
class Stored:
    """A file in the store: hex SHA-256 and size in bytes."""

    sha256: str
    size: int


class ArtifactStore:
    """Files under `root/aa/<sha256>`, never changed once written. Equal bytes are stored once."""

    def __init__(self, root: Path) -> None:
        self._root = root

    def put(self, source: Path) -> Stored:
        """Copy a file in. It is on the disk when this returns: a row that names it never names nothing."""
        data = source.read_bytes()
        stored = Stored(hashlib.sha256(data).hexdigest(), len(data))
        goal = self.path(stored.sha256)
        if goal.exists():
            return stored
        goal.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=goal.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            Path(temporary).replace(goal)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise
        _sync_directory(goal.parent)
        return stored

    def path(self, sha256: str) -> Path:
        """Where the file with this hash lies, if it does."""
        return self._root / sha256[:2] / sha256


def media_type(name: str) -> str:
    """The media type of an artifact."""
    return MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")


def _sync_directory(directory: Path) -> None:
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
