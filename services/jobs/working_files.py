"""Files of running jobs: checkpoints, and the directory into which an attempt writes. No result depends on them.

Machines that share a store copy the checkpoints of long jobs to it (`checkpoint_copies`).
"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.jobs.checkpoint_copies import CheckpointCopies
from services.jobs.leases import Attempt
from services.jobs.record import Record


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
        job = record.jobs.get(job_id)
        if job is None or job.state.terminal:
            for file in self._checkpoints.glob(f"{job_id}*"):
                file.unlink(missing_ok=True)
            if self._copies is not None:
                self._copies.forget(job_id)

    def forget_copies(self, record: Record) -> None:
        """Removes the copies of checkpoints of jobs that have ended. Raises OSError if the store does not answer."""
        if self._copies is None:
            return
        for job_id in self._copies.job_ids():
            job = record.jobs.get(job_id)
            if job is None or job.state.terminal:
                self._copies.remove(job_id)

    def sweep(self, record: Record) -> None:
        """Removes the files that killed processes left behind of attempts and jobs that have ended."""
        for out in self._running.glob("*-*"):
            job_id, _, number = out.name.rpartition("-")
            job = record.jobs.get(job_id)
            if job is None or job.state.terminal or job.attempt != int(number):
                shutil.rmtree(out, ignore_errors=True)
        for file in list(self._checkpoints.glob("*")):
            self.forget(record, file.name.partition(".")[0])
