"""Stores meshes that users upload: validated once, named by the SHA-256 of their bytes, never by a user's file name."""

import hashlib
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from services import atomic_write
from services.errors import InvalidRequest, JobFailure
from services.scenes.isolated_reading import reader
from services.scenes.mesh import Mesh
from services.scenes.store import load_parts, mesh_path, save_parts
from services.settings import Settings, settings


class Upload(BaseModel):
    """Metadata of an uploaded mesh, stored beside it as JSON. `size` is in bytes."""

    model_config = ConfigDict(frozen=True)

    sha256: str
    kind: str
    size: int
    triangles: int
    notes: tuple[str, ...] = ()
    """What the file refers to and the mesh therefore lacks, in sentences."""


class Uploads:
    """The uploaded meshes under one directory: `<sha256>` with the bytes and `<sha256>.json` with an `Upload`."""

    def __init__(self, directory: Path, processed: Path) -> None:
        self._directory = directory
        self._processed = processed

    def add(self, data: bytes, kind: str, limits: Settings | None = None) -> Upload:
        """Validates and stores a file, and returns its metadata; a file that is stored already is not validated again.

        Raises InvalidRequest("kind", …) for a kind that is not read, InvalidRequest("file", …) for invalid or too many
        bytes.
        """
        limits = limits or settings()
        if len(data) > limits.max_upload_bytes:
            raise InvalidRequest("file", f"it has {len(data):,} bytes; at most {limits.max_upload_bytes:,} are taken")
        sha256 = hashlib.sha256(data).hexdigest()
        known = self.record(sha256)
        if known is not None and known.kind == kind:
            return known
        parts, notes = reader().read_mesh(data, kind, limits.max_faces)
        record = Upload(
            sha256=sha256,
            kind=kind,
            size=len(data),
            triangles=sum(len(part.faces) for part in parts),
            notes=notes,
        )
        save_parts(mesh_path(self._processed, f"{sha256}-{kind}"), parts)
        # The metadata is written last, so that every listed upload is complete.
        atomic_write.write(self._directory / sha256, data)
        atomic_write.write(self._directory / f"{sha256}.json", record.model_dump_json().encode())
        return record

    def record(self, sha256: str) -> Upload | None:
        """Returns the metadata of the upload with this digest (64 hexadecimal digits); None if there is none."""
        try:
            return Upload.model_validate_json((self._directory / f"{sha256}.json").read_bytes())
        except (OSError, ValidationError):
            return None

    def all(self) -> list[Upload]:
        """Returns the metadata of all uploads, ordered by digest."""
        names = sorted(path.stem for path in self._directory.glob("*.json") if not path.name.startswith("."))
        return [record for record in map(self.record, names) if record is not None]

    def load(self, upload: Upload) -> Mesh:
        """Returns the mesh of an upload. Raises JobFailure("asset-missing") if its bytes are missing or changed."""
        kept = mesh_path(self._processed, f"{upload.sha256}-{upload.kind}")
        parts = load_parts(kept)
        if parts is None:
            try:
                data = (self._directory / upload.sha256).read_bytes()
            except OSError as error:
                raise JobFailure("asset-missing", f"the uploaded mesh {upload.sha256} has gone: {error}") from error
            if hashlib.sha256(data).hexdigest() != upload.sha256:
                raise JobFailure("asset-missing", f"the uploaded mesh {upload.sha256} has changed on disk")
            parts, _ = reader().read_mesh(data, upload.kind, settings().max_faces)
            save_parts(kept, parts)
        return Mesh(parts=parts, sha256=upload.sha256, credit=None)
