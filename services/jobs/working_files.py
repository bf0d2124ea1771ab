"""Files of jobs on their way: checkpoints, and the directory an attempt writes into. All of it may be lost."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.jobs.attempts import Attempt
from services.jobs.repository import Repository


class WorkingFiles:
    """`data_dir/checkpoints/<job id>` and `data_dir/running/<job id>-<attempt>/`."""

    def __init__(self, data_dir: Path) -> None:
        self._checkpoints = data_dir / "checkpoints"
        self._running = data_dir / "running"

    def checkpoint(self, job_id: str) -> Path:
        """The file a job saves itself to, so that a later attempt goes on from there."""
        self._checkpoints.mkdir(parents=True, exist_ok=True)
        return self._checkpoints / job_id

    @contextmanager
    def attempt_directory(self, attempt: Attempt) -> Iterator[Path]:
        """An empty directory for one attempt, gone afterwards."""
        out = self._running / f"{attempt.job_id}-{attempt.number}"
        out.mkdir(parents=True)
        try:
            yield out
        finally:
            shutil.rmtree(out, ignore_errors=True)

    def forget(self, repository: Repository, job_id: str) -> None:
        """Remove a job's checkpoint if the job is over."""
        job = repository.get(job_id)
        if job is None or job.state.terminal:
            for file in self._checkpoints.glob(f"{job_id}*"):
                file.unlink(missing_ok=True)

    def sweep(self, repository: Repository) -> None:
        """Remove what killed processes left behind of attempts and jobs that are over."""
        for out in self._running.glob("*-*"):
            job_id, _, number = out.name.rpartition("-")
            job = repository.get(job_id)
            if job is None or job.state.terminal or job.attempt != int(number):
                shutil.rmtree(out, ignore_errors=True)
        for file in self._checkpoints.glob("*"):
            self.forget(repository, file.name.partition(".")[0])
