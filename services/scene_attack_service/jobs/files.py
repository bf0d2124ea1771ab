"""The files of jobs: the artifact store, the checkpoints and folders of running jobs, and the removal of what nothing
needs any more.

An artifact is named by the hash of its bytes, and verified by it on reading. No result depends on the files of running
jobs: a checkpoint that is missing, old or damaged only makes an attempt repeat more.
"""

import hashlib
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedIOBase
from pathlib import Path
from typing import TypeVar

from sqlalchemy.exc import SQLAlchemyError

from scene_attack import disk
from scene_attack.blobs import blobs
from scene_attack.logs import logger
from scene_attack.scenes.library import Library
from scene_attack.scenes.store import limit
from scene_attack_service.jobs.database import DISK_FULL, outage_of
from scene_attack_service.jobs.leases import Attempt, Standing
from scene_attack_service.jobs.models import Artifact
from scene_attack_service.jobs.record import Record
from scene_attack_service.jobs.uploads import DeletedAssets
from scene_attack_service.settings import Settings

MEDIA_TYPES = {".json": "application/json", ".png": "image/png"}
"""Media types by file name ending. All other files, safetensors too, are application/octet-stream."""


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

    def put(self, source: Path) -> Artifact:
        """Copies a file into the store, and returns its row, of no job yet. Its bytes are safe when this returns."""
        data = source.read_bytes()
        sha256 = hashlib.sha256(data).hexdigest()
        if not self._files.keep(_name(sha256)):
            self._files.write(_name(sha256), data)
        kind = MEDIA_TYPES.get(source.suffix, "application/octet-stream")
        return Artifact(name=source.name, sha256=sha256, media_type=kind, size=len(data))

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


COPY_SECONDS = 10.0
"""Shortest time between two copies of a checkpoint; a job that ends earlier makes none."""
SHARE = 0.1
"""Part of the time that copies may take: after one that took long, the next waits."""
WAIT_SECONDS = 10.0
"""Longest wait at the end of an attack for a copy that is being made."""
_DIGEST_BYTES = hashlib.sha256().digest_size

log = logger(__name__)


class CheckpointCopies:
    """Objects `checkpoints/<job id>` of the store at a URL: SHA-256 of the job's id and the checkpoint, and then the
    checkpoint. What the store does not do is logged, and raises nothing.
    """

    def __init__(self, url: str) -> None:
        self._files = blobs(url, "checkpoints")

    @contextmanager
    def kept(self, job_id: str, path: Path) -> Iterator[None]:
        """Copies the checkpoint `path` whenever it has changed, until left."""
        ended = threading.Event()
        thread = threading.Thread(target=self._keep, args=(job_id, path, ended), daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join(WAIT_SECONDS)

    def _keep(self, job_id: str, path: Path, ended: threading.Event) -> None:
        wait, copied = COPY_SECONDS, 0
        while not ended.wait(wait):
            started = time.monotonic()
            try:
                changed = path.stat().st_mtime_ns
                if changed != copied:  # reading it each time would look like the work of a job process that hangs
                    data = path.read_bytes()
                    self._files.write(job_id, _digest(job_id, data) + data)
                    copied = changed
            except FileNotFoundError:
                continue
            except OSError as error:
                log.warning("checkpoint not copied", job=job_id, error=str(error))
            wait = max(COPY_SECONDS, (time.monotonic() - started) / SHARE)

    def fetch(self, job_id: str, path: Path) -> None:
        """Writes the copy to `path` if it has got further than the checkpoint that is there, and is undamaged."""
        from scene_attack.attacks.run import saved_step  # loads torch, which the API must not

        try:
            with self._files.open(job_id) as file:
                digest, data = file.read(_DIGEST_BYTES), file.read()
        except FileNotFoundError:
            return
        except OSError as error:
            log.warning("copy of a checkpoint not read", job=job_id, error=str(error))
            return
        if digest != _digest(job_id, data):
            log.warning("damaged copy of a checkpoint ignored", job=job_id)
            return
        fetched = path.with_name(f"{path.name}.fetched")
        disk.write(fetched, data)
        if saved_step(fetched) > saved_step(path):
            fetched.replace(path)
            log.info("going on from another machine's checkpoint", job=job_id, step=saved_step(path))
        else:
            fetched.unlink()

    def remove(self, job_id: str) -> None:
        """Removes the copy, if there is one."""
        try:
            self._files.delete(job_id)
        except OSError as error:
            log.warning("copy of a checkpoint not removed yet", job=job_id, error=str(error))

    def job_ids(self) -> list[str]:
        """The ids of the jobs that have a copy. Raises OSError if the store does not answer."""
        return self._files.names()


def _digest(job_id: str, data: bytes) -> bytes:
    return hashlib.sha256(job_id.encode() + data).digest()


class WorkingFiles:
    """The files `data_dir/checkpoints/<job id>` and the directories `data_dir/running/<job id>-<attempt>/`."""

    def __init__(self, data_dir: Path, place: Path | str | None = None) -> None:
        """place: where the artifacts are; checkpoints are copied to it if it is the URL of a store."""
        self._checkpoints = data_dir / "checkpoints"
        self._running = data_dir / "running"
        self._copies = CheckpointCopies(place) if isinstance(place, str) else None

    @contextmanager
    def checkpoint(self, attempt: Attempt) -> Iterator[Path]:
        """Yields the path of a job's checkpoint, from which the attempt resumes if it is not the first one."""
        self._checkpoints.mkdir(parents=True, exist_ok=True)
        path = self.left_of(attempt.job_id)
        if self._copies is None:
            yield path
            return
        if attempt.number > 1:
            self._copies.fetch(attempt.job_id, path)
        with self._copies.kept(attempt.job_id, path):
            yield path

    def left_of(self, job_id: str) -> Path:
        """The path of a job's checkpoint on this machine, where there may be none."""
        return self._checkpoints / job_id

    @contextmanager
    def attempt_directory(self, attempt: Attempt) -> Iterator[Path]:
        """Creates an empty directory for one attempt, and removes it on leaving."""
        out = self._running / f"{attempt.job_id}-{attempt.number}"
        shutil.rmtree(out, ignore_errors=True)  # a database that was restored counts attempts again
        out.mkdir(parents=True)
        try:
            yield out
        finally:
            shutil.rmtree(out, ignore_errors=True)

    def forget(self, record: Record, job_id: str) -> None:
        """Removes a job's checkpoint if the job has ended."""
        if not record.jobs.is_open(job_id):
            for file in self._checkpoints.glob(f"{job_id}*"):
                file.unlink(missing_ok=True)
            if self._copies is not None:
                self._copies.remove(job_id)

    def forget_copies(self, record: Record) -> None:
        """Removes the copies of checkpoints of jobs that have ended. Raises OSError if the store does not answer."""
        if self._copies is None:
            return
        for job_id in self._copies.job_ids():
            if not record.jobs.is_open(job_id):
                self._copies.remove(job_id)

    def sweep(self, record: Record) -> None:
        """Removes the files that killed processes left behind of attempts and jobs that have ended."""
        for out in self._running.glob("*-*"):
            job_id, _, number = out.name.rpartition("-")
            if record.leases.standing(Attempt(job_id, int(number))) is Standing.LOST:
                shutil.rmtree(out, ignore_errors=True)
        for file in list(self._checkpoints.glob("*")):
            self.forget(record, file.name.partition(".")[0])


FREE_BYTES = 16 * 2**20
"""Free space below which the disk is full: the files of a job take a few megabytes."""
REMEMBER_SECONDS = 1.0
"""Time for which the answer of `Storage.usable` is remembered."""
RESERVE = "reserve"
"""The file in the data directory whose space is given up when the disk is full."""
RESERVE_BYTES = 4 * 2**20
"""Size of that file, in bytes. SQLite's log grows to 4 MB; the record of a cancelled job adds tens of kilobytes."""
_PROBE = bytes(4096)

T = TypeVar("T")


class Storage:
    """The data directory `folder`, and the store of artifacts if it is elsewhere."""

    def __init__(
        self, folder: Path, store: ArtifactStore | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._folder = folder
        self._store = store
        self._clock = clock
        self._found = False
        self._looked = float("-inf")

    def usable(self) -> bool:
        """Whether files can be written there and the store answers, as of a second ago at most."""
        now = self._clock()
        if now - self._looked >= REMEMBER_SECONDS:
            self._found = _writable(self._folder) and (self._store is None or self._store.answers())
            self._looked = self._clock()
        return self._found

    def keep_reserve(self) -> None:
        """Sets space aside where there is enough of it and none is set aside yet. Raises OSError."""
        reserve = self._folder / RESERVE
        if not reserve.exists() and self.usable():
            with reserve.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, RESERVE_BYTES)

    def even_if_full(self, write: Callable[[], T]) -> T:
        """Returns what a small transaction returns. Where the disk is too full for it, it gets the space set aside.

        Raises SQLAlchemyError.
        """
        try:
            return write()
        except SQLAlchemyError as error:
            if outage_of(error) != DISK_FULL:
                raise
            with suppress(OSError):
                (self._folder / RESERVE).unlink(missing_ok=True)
            return write()


def _writable(folder: Path) -> bool:
    try:
        space = os.statvfs(folder)
        if space.f_bavail * space.f_frsize < FREE_BYTES:
            return False
        with tempfile.TemporaryFile(dir=folder) as probe:  # it has no name, so nothing is left of it
            probe.write(_PROBE)
            probe.flush()
            os.fsync(probe.fileno())
    except OSError:
        return False
    return True


GRACE_SECONDS = 3600.0
"""Age below which a file that nothing names is kept: a job may be about to name it."""
SWEEP_SECONDS = 60.0
"""Time between two looks at the files of running jobs."""
SEARCH_SECONDS = 3600.0
"""Time between two searches for files that nothing names."""


def delete_with_files(record: Record, store: ArtifactStore, job_id: str) -> None:
    """Deletes a job, and the files that only it has named for an hour; younger ones go later. Raises InUse."""
    _remove_unnamed(record, store, record.jobs.delete(job_id))


def _remove_unnamed(record: Record, store: ArtifactStore, hashes: Iterable[str]) -> None:
    for sha256 in record.jobs.unnamed(set(hashes)):
        store.remove(sha256, GRACE_SECONDS)


class Housekeeping:
    """Keeps data directory, artifact store and cache tidy, as the settings say."""

    def __init__(self, record: Record, settings: Settings) -> None:
        self._record = record
        self._settings = settings
        self._store = ArtifactStore(settings.files)
        self._working_files = WorkingFiles(settings.data_dir, settings.files)
        self._storage = Storage(settings.data_dir)
        self._assets = DeletedAssets(record.database, Library(settings.cache_dir, settings.files))
        self._swept = self._searched = float("-inf")

    def tidy(self) -> None:
        """Does what is due. Raises SQLAlchemyError and OSError; what is left is done the next time."""
        self._storage.keep_reserve()
        now = time.monotonic()
        if now - self._swept >= SWEEP_SECONDS:
            self._swept = now
            self._working_files.sweep(self._record)
            limit(self._settings.cache_dir / "meshes", self._settings.cache_bytes)
            if self._settings.retention_days is not None:
                gone = self._record.jobs.expire(self._settings.retention_days)
                _remove_unnamed(self._record, self._store, gone)
        if now - self._searched >= SEARCH_SECONDS:
            self._searched = now
            _remove_unnamed(self._record, self._store, self._store.names())
            self._assets.remove_all()
            self._working_files.forget_copies(self._record)
            remove_unfinished(self._settings.data_dir)


def remove_unfinished(folder: Path) -> None:
    """Removes files that killed processes left half-written (scene_attack.disk), unless they may be in progress."""
    for part in folder.rglob("*.part"):
        with suppress(FileNotFoundError):  # its writer has finished meanwhile
            if time.time() - part.stat().st_mtime > GRACE_SECONDS:
                part.unlink()
