"""Copies of checkpoints in the store that all machines share, so that another machine goes on where one has died.

A job process writes its checkpoint to its own disk every few seconds. A thread beside the attack copies the file, so
that no step waits for the store. No result depends on a copy: if one is missing, old or damaged, more is repeated.
"""

import hashlib
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services import atomic_write
from services.blobs import blobs
from services.logs import logger

COPY_SECONDS = 10.0
"""Shortest time between two copies of a checkpoint; a job that ends earlier makes none."""
SHARE = 0.1
"""Part of the time that copies may take: after one that took long, the next waits."""
WAIT_SECONDS = 10.0
"""How long the end of an attack waits for a copy that is being made."""
_DIGEST_BYTES = hashlib.sha256().digest_size

log = logger(__name__)


class CheckpointCopies:
    """Objects `checkpoints/<job id>` of the store at a URL: SHA-256 of the job's id and the checkpoint, and then the
    checkpoint. What the store does not do is logged, and raises nothing.
    """

    def __init__(self, url: str) -> None:
        self._files = blobs(url, "checkpoints")
        self._there: set[str] = set()
        """Ids of jobs whose copy this process has made or read."""

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
                    self._there.add(job_id)
                    self._files.write(job_id, _digest(job_id, data) + data)
                    copied = changed
            except FileNotFoundError:
                continue
            except OSError as error:
                log.warning("checkpoint not copied", job=job_id, error=str(error))
            wait = max(COPY_SECONDS, (time.monotonic() - started) / SHARE)

    def fetch(self, job_id: str, path: Path) -> None:
        """Writes the copy to `path` if it has got further than the checkpoint that is there, and is undamaged."""
        from services.attacks.run import saved_step  # loads torch, which the API must not

        try:
            with self._files.open(job_id) as file:
                digest, data = file.read(_DIGEST_BYTES), file.read()
        except FileNotFoundError:
            return
        except OSError as error:
            log.warning("copy of a checkpoint not read", job=job_id, error=str(error))
            return
        self._there.add(job_id)
        if digest != _digest(job_id, data):
            log.warning("damaged copy of a checkpoint ignored", job=job_id)
            return
        fetched = path.with_name(f"{path.name}.fetched")
        atomic_write.write(fetched, data)
        if saved_step(fetched) > saved_step(path):
            fetched.replace(path)
            log.info("going on from another machine's checkpoint", job=job_id, step=saved_step(path))
        else:
            fetched.unlink()

    def forget(self, job_id: str) -> None:
        """Removes the copy, if this process has made or read one."""
        if job_id in self._there:
            self._there.discard(job_id)
            self.remove(job_id)

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
