"""The artifact store: files of results, each named by the hash of its bytes."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from services import atomic_write

MEDIA_TYPES = {".json": "application/json", ".png": "image/png"}
"""Media types by file name ending. All other files, safetensors too, are application/octet-stream."""


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
        """Copies a file into the store. Its bytes are on the disk when this returns, so a row may then name them."""
        data = source.read_bytes()
        stored = Stored(hashlib.sha256(data).hexdigest(), len(data))
        goal = self.path(stored.sha256)
        if not goal.exists():
            atomic_write.write(goal, data)
        return stored

    def path(self, sha256: str) -> Path:
        """The path of the file with this hash, whether or not it exists."""
        return self._root / sha256[:2] / sha256


def media_type(name: str) -> str:
    """The media type of an artifact with this file name."""
    return MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
