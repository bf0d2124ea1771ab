"""A consistent copy of a service's data while it runs.

The database is copied first. Files never change and are written before a row names them, so that the files copied
afterwards hold everything that the copied database names.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from services import atomic_write
from services.blobs import Blobs, blobs
from services.errors import InvalidRequest, JobFailure
from services.jobs.database import check_database, connect
from services.jobs.database_copy import SQLITE, copy_database
from services.settings import Settings

PARTS = ("artifacts", "assets")
"""What is copied of the place of artifacts. What else is there belongs to running jobs, which begin again without."""
_CHUNK_BYTES = 2**20


@dataclass(frozen=True)
class Backup:
    """What a backup holds: the number of files and their bytes, and that of jobs."""

    files: int
    size: int
    jobs: int


def back_up(settings: Settings, folder: Path) -> Backup:
    """Copies the database and all artifacts and assets into `folder`, which is made.

    Raises InvalidRequest("FOLDER") if there is something in the folder, JobFailure("internal") if a file that the
    database names is missing or damaged: it was deleted meanwhile, or long ago; what `check_database` and
    `copy_database` raise, and OSError if a file cannot be read or written.
    """
    if folder.exists() and any(folder.iterdir()):
        raise InvalidRequest("FOLDER", f"{folder} is not empty; name one that does not exist yet")
    if settings.database_url is None and not (settings.data_dir / SQLITE).exists():
        raise InvalidRequest("--data", f"there is no database in {settings.data_dir}")
    engine = connect(settings)
    try:
        check_database(engine, settings)
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        copied = copy_database(engine, folder)
    finally:
        engine.dispose()
    files, size, whole = 0, 0, set()
    for part in PARTS:
        source = blobs(settings.files, part)
        for name in source.names():
            found = _copy(source, name, folder / part / name)
            if found is not None:
                sha256, length = found
                files, size = files + 1, size + length
                if sha256 == Path(name).name:
                    whole.add(sha256)
    _check(copied.artifacts, whole)
    return Backup(files, size, copied.jobs)


def _copy(source: Blobs, name: str, goal: Path) -> tuple[str, int] | None:
    """Copies a file and returns its SHA-256 and its size in bytes; None if it was deleted meanwhile."""
    try:
        file = source.open(name)
    except FileNotFoundError:  # `_check` says if the database names it
        return None
    digest, size = hashlib.sha256(), 0
    with file, atomic_write.replacing(goal) as part, part.open("wb") as copy:
        while chunk := file.read(_CHUNK_BYTES):
            copy.write(chunk)
            digest.update(chunk)
            size += len(chunk)
    return digest.hexdigest(), size


def _check(named: frozenset[str], whole: set[str]) -> None:
    """Raises JobFailure if the copies of some artifacts that the database names are missing or damaged."""
    missing = sorted(named - whole)
    if missing:
        detail = f"{len(missing)} of {len(named)} artifacts are missing or damaged, such as {missing[0]}; back up again"
        raise JobFailure("internal", detail)
