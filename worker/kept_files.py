"""What a job process keeps of a job in the artifact store: the files of its result, or what it had found until then."""

import shutil
from pathlib import Path

from services import disk
from services.jobs.files import ArtifactStore, Damaged, Storage, WorkingFiles, media_type
from services.jobs.leases import Attempt
from services.jobs.models import Artifact, Job, JobKind
from services.jobs.record import Record
from services.logs import logger
from services.pipeline.best_so_far import best_so_far
from services.pipeline.result import CHECKPOINT
from services.pipeline.spec import parse
from services.scenes.library import Library

log = logger(__name__)


class KeptFiles:
    """Puts the files of jobs into the store, and takes the checkpoint from it that a job is to go on from."""

    def __init__(
        self,
        record: Record,
        store: ArtifactStore,
        working_files: WorkingFiles,
        library: Library,
        storage: Storage,
    ) -> None:
        self._record = record
        self._store = store
        self._working_files = working_files
        self._library = library
        self._storage = storage

    def go_on(self, attempt: Attempt, path: Path) -> None:
        """Writes the checkpoint that the job is to go on from, if it has one and has made none of its own yet."""
        if path.exists():
            return
        try:
            given = self.given(attempt, CHECKPOINT)
            if given is not None:
                disk.write(path, given)
        except (FileNotFoundError, Damaged) as error:
            log.warning("checkpoint gone, the job begins again", job=attempt.job_id, error=str(error))

    def given(self, attempt: Attempt, name: str) -> bytes | None:
        """The bytes of a file that the job began with, or None. Raises FileNotFoundError and Damaged."""
        artifact = self._record.jobs.artifact(attempt.job_id, name)
        if artifact is None:
            return None
        with self._store.open(artifact.sha256) as file:
            return file.read()

    def left(self, attempt: Attempt, job: Job) -> list[Artifact]:
        """The files of an attack that ends early: its checkpoint, and the best that it has found, rendered exactly.

        There are none if the disk is full: what space is left is for the record of the job's end.
        """
        path = self._working_files.left_of(attempt.job_id)
        if job.kind is not JobKind.ATTACK or not path.exists():
            return []
        if not self._storage.usable():
            log.warning("checkpoint not kept, the disk is full", job=attempt.job_id)
            return []
        try:
            with self._working_files.attempt_directory(attempt) as out:
                try:
                    best_so_far(parse(job.spec), path, out, self._library)
                except Exception as error:
                    log.warning("best so far not rendered", job=attempt.job_id, exc_info=error)
                shutil.copyfile(path, out / CHECKPOINT)
                return self.stored(attempt, out)
        except OSError as error:
            log.warning("checkpoint not kept", job=attempt.job_id, error=str(error))
            return []

    def stored(self, attempt: Attempt, out: Path) -> list[Artifact]:
        """The files of a directory, put into the store."""
        artifacts = []
        for file in sorted(out.iterdir()):
            stored = self._store.put(file)
            artifacts.append(
                Artifact(
                    job_id=attempt.job_id,
                    name=file.name,
                    sha256=stored.sha256,
                    media_type=media_type(file.name),
                    size=stored.size,
                )
            )
        return artifacts
