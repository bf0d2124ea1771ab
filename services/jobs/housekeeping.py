"""Removes what nothing needs any more: files of jobs that were deleted, and files that killed processes left behind."""

import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from services.jobs.artifacts import ArtifactStore
from services.jobs.asset_removal import DeletedAssets
from services.jobs.record import Record
from services.jobs.storage import Storage
from services.jobs.working_files import WorkingFiles
from services.scenes.store import limit

GRACE_SECONDS = 3600.0
"""Age below which a file that nothing names is kept: a job may be about to name it."""
SWEEP_SECONDS = 60.0
"""Time between two looks at the files of running jobs."""
SEARCH_SECONDS = 3600.0
"""Time between two searches for files that nothing names."""


class Housekeeping:
    """Keeps data directory and cache tidy. Jobs are deleted `retention_days` after their end; None keeps them for ever.
    `meshes` is the folder of processed meshes and the bytes that they may take; None leaves them alone. `assets` has
    the uploads that were deleted. `place` has the artifacts, and copies of checkpoints if it is the URL of a store.
    """

    def __init__(
        self,
        record: Record,
        store: ArtifactStore,
        data_dir: Path,
        retention_days: float | None = None,
        meshes: tuple[Path, int] | None = None,
        assets: DeletedAssets | None = None,
        place: Path | str | None = None,
    ) -> None:
        self._record = record
        self._store = store
        self._working_files = WorkingFiles(data_dir, place)
        self._data_dir = data_dir
        self._storage = Storage(data_dir)
        self._retention_days = retention_days
        self._meshes = meshes
        self._assets = assets
        self._swept = self._searched = float("-inf")

    def delete(self, job_id: str) -> None:
        """Deletes a job, and the files that only it has named for an hour; younger ones go later. Raises InUse."""
        self._remove(self._record.jobs.delete(job_id))

    def tidy(self) -> None:
        """Does what is due. Raises SQLAlchemyError and OSError; what is left is done the next time."""
        self._storage.keep_reserve()
        now = time.monotonic()
        if now - self._swept >= SWEEP_SECONDS:
            self._swept = now
            self._working_files.sweep(self._record)
            if self._meshes is not None:
                limit(*self._meshes)
            if self._retention_days is not None:
                self._remove(self._record.jobs.expire(self._retention_days))
        if now - self._searched >= SEARCH_SECONDS:
            self._searched = now
            self._remove(self._store.names())
            if self._assets is not None:
                self._assets.remove_all()
            self._working_files.forget_copies(self._record)
            remove_unfinished(self._data_dir)

    def _remove(self, hashes: Iterable[str]) -> None:
        for sha256 in self._record.jobs.unnamed(set(hashes)):
            self._store.remove(sha256, GRACE_SECONDS)


def remove_unfinished(folder: Path) -> None:
    """Removes files that killed processes left half-written (services.atomic_write), unless they may be in progress."""
    for part in folder.rglob("*.part"):
        with suppress(FileNotFoundError):  # its writer has finished meanwhile
            if time.time() - part.stat().st_mtime > GRACE_SECONDS:
                part.unlink()
