"""Files of running jobs: checkpoints, and the directory into which an attempt writes. No result depends on them."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from services.jobs.attempts import Attempt
from services.jobs.repository import Repository


class WorkingFiles:
    """The files `data_dir/checkpoints/<job id>` and the directories `data_dir/running/<job id>-<attempt>/`."""

    def __init__(self, data_dir: Path) -> None:
        self._checkpoints = data_dir / "checkpoints"
        self._running = data_dir / "running"

    def checkpoint(self, job_id: str) -> Path:
        """The path of a job's checkpoint, from which a later attempt resumes."""
        self._checkpoints.mkdir(parents=True, exist_ok=True)
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

    def forget(self, repository: Repository, job_id: str) -> None:
        """Removes a job's checkpoint if the job has ended."""
        job = repository.get(job_id)
        if job is None or job.state.terminal:
            for file in self._checkpoints.glob(f"{job_id}*"):
                file.unlink(missing_ok=True)

    def sweep(self, repository: Repository) -> None:
        """Removes the files that killed processes left behind of attempts and jobs that have ended."""
        for out in self._running.glob("*-*"):
            job_id, _, number = out.name.rpartition("-")
            job = repository.get(job_id)
            if job is None or job.state.terminal or job.attempt != int(number):
                shutil.rmtree(out, ignore_errors=True)
        for file in list(self._checkpoints.glob("*")):
            self.forget(repository, file.name.partition(".")[0])
