"""The artifact store: files of results, each named by the hash of its bytes and verified by it on reading."""

import hashlib
from dataclasses import dataclass
from io import BufferedIOBase
from pathlib import Path

from services.blobs import blobs

MEDIA_TYPES = {".json": "application/json", ".png": "image/png"}
"""Media types by file name ending. All other files, safetensors too, are application/octet-stream."""


@dataclass(frozen=True)
class Stored:
    """A file in the store: hex SHA-256 and size in bytes."""

    sha256: str
    size: int


class Damaged(Exception):
    """The bytes of an artifact are not those that were stored."""


class ArtifactStore:
    """Files `artifacts/aa/<sha256>` in a folder or an object store, never changed once written. Equal bytes are stored
    once.
    """

    def __init__(self, place: Path | str) -> None:
        self._files = blobs(place, "artifacts")

    def answers(self) -> bool:
        """Whether the store can be reached."""
        try:
            self._files.exists(_name("0" * 64))  # which need not be there
        except OSError:
            return False
        return True

    def put(self, source: Path) -> Stored:
        """Copies a file into the store. Its bytes are safe when this returns, so a row may then name them."""
        data = source.read_bytes()
        stored = Stored(hashlib.sha256(data).hexdigest(), len(data))
        if not self._files.keep(_name(stored.sha256)):
            self._files.write(_name(stored.sha256), data)
        return stored

    def names(self) -> list[str]:
        """The hashes of all files."""
        return [name.rpartition("/")[2] for name in self._files.names()]

    def remove(self, sha256: str, unwanted_seconds: float) -> None:
        """Removes a file, unless it was put within the last `unwanted_seconds`: a row may be about to name it."""
        self._files.remove(_name(sha256), unwanted_seconds)

    def open(self, sha256: str) -> BufferedIOBase:
        """Opens the file with this hash, at its beginning, after all its bytes were compared with the hash.

        Raises FileNotFoundError if it is gone, Damaged if it is another file by now.
        """
        file = self._files.open(_name(sha256))
        try:
            if hashlib.file_digest(file, "sha256").hexdigest() != sha256:
                raise Damaged(f"the bytes of artifact {sha256} are not those that were stored")
            file.seek(0)
        except BaseException:
            file.close()
            raise
        return file


def _name(sha256: str) -> str:
    return f"{sha256[:2]}/{sha256}"


def media_type(name: str) -> str:
    """The media type of an artifact with this file name."""
    return MEDIA_TYPES.get(Path(name).suffix, "application/octet-stream")
