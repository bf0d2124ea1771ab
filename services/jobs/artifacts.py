"""The artifact store: files of results under the hash of their bytes."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from services import atomic_write

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
        if not goal.exists():
            atomic_write.write(goal, data)
        return stored

    def path(self, sha256: str) -> Path:
        """Where the file with this hash lies, if it does."""
        return self._root / sha256[:2] / sha256


def media_type(name: str) -> str:
    """The media type of an artifact."""
    return MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
