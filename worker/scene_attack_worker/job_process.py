"""The warm process that runs jobs: networks and the OpenGL context are loaded once and kept from job to job.

A worker starts it with `python -m scene_attack_worker.job_process FD`. The process writes progress and outcome to the
record, and the files of a job to the artifact store: those of its result, or what it had found until then. The worker
renews the lease, and kills the process if it does not stop.
"""

import base64
import json
import os
import shutil
import time
from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path
from typing import Any

from scene_attack import disk
from scene_attack.analysis.images import png
from scene_attack.errors import Cancelled, InvalidRequest, JobFailure, out_of_memory, summary
from scene_attack.logs import bound, configure, logger
from scene_attack.process import device
from scene_attack.runs.analyse import decode_image, rerender_image
from scene_attack.runs.campaign_plan import View
from scene_attack.runs.campaign_run import first_answers
from scene_attack.runs.execute import Progress, best_so_far, execute
from scene_attack.runs.result import CHECKPOINT, JobWarning, outcome
from scene_attack.runs.spec import RENDERING, SENT_IMAGE, JobSpec, RerenderingSpec, RerenderingView, digest, parse
from scene_attack.runs.task_parts import Member
from scene_attack.scenes.library import Library
from scene_attack.targets.info import TARGETS
from scene_attack_service.jobs.database import connect as connect_database
from scene_attack_service.jobs.database import outage_of
from scene_attack_service.jobs.files import ArtifactStore, Damaged, Storage, WorkingFiles
from scene_attack_service.jobs.leases import Attempt, Standing
from scene_attack_service.jobs.models import Artifact, Job, JobKind
from scene_attack_service.jobs.processes import connect, give_way, memory_limit, more_than, reply, requests, warm_up
from scene_attack_service.jobs.queue import Abilities
from scene_attack_service.jobs.record import Record
from scene_attack_service.settings import Settings

log = logger(__name__)


REPORT_SECONDS = 0.25
"""Shortest time between two writes of progress. The next write includes the trace rows since the last one."""
POLL_SECONDS = 0.25
"""Shortest time between two reads of the record before a rendering, to see whether to stop."""

KEEPING_SECONDS, KEEPING_SHARE = 30.0, 0.1
"""Part of a job's time that is reserved for keeping what it has found: in seconds, and at most as a share of it."""


class Reporter:
    """Writes a job's progress to the record, and reads from it whether the job should stop."""

    def __init__(
        self,
        record: Record,
        attempt: Attempt,
        clock: Callable[[], float] = time.monotonic,
        seconds: float = inf,
    ) -> None:
        self._record = record
        self._ends_at = clock() + seconds
        self._seconds = seconds
        self._attempt = attempt
        self._clock = clock
        self._rows: list[dict[str, Any]] = []
        self._phase: str | None = None
        self._reported_at = self._checked_at = float("-inf")
        self._stop = False

    def progress(self, progress: Progress) -> None:
        """Records the progress; the job calls it once a step. Raises JobFailure("non-finite")."""
        if progress.row is not None:
            self._rows.append(finite(progress.row.model_dump(mode="json")))
        now = self._clock()
        if progress.phase == self._phase and now - self._reported_at < REPORT_SECONDS:
            return
        self._phase, self._reported_at = progress.phase, now
        self._record.leases.progress(self._attempt, progress.phase, progress.step, progress.steps, self._rows)
        self._rows = []

    def stop(self) -> bool:
        """Whether the job was cancelled or the attempt has lost its lease. Raises JobFailure("timeout")."""
        now = self._clock()
        if now > self._ends_at:
            detail = f"it ran longer than {self._seconds:g} seconds, the most that an attack may take"
            raise JobFailure("timeout", detail)
        if not self._stop and now - self._checked_at >= POLL_SECONDS:
            self._checked_at = now
            self._stop = self._record.leases.standing(self._attempt) is not Standing.GO_ON
        return self._stop


def finite(record: dict[str, Any]) -> dict[str, Any]:
    """Returns `record` if all its numbers are finite; otherwise raises JobFailure("non-finite")."""
    try:
        json.dumps(record, allow_nan=False)
    except ValueError as error:
        raise JobFailure("non-finite", "the job produced a number that is infinite or not a number") from error
    return record


class Jobs:
    """The record, the files, the library and the working files, which the process keeps between jobs."""

    def __init__(self, settings: Settings) -> None:
        self._record = Record(connect_database(settings))
        self._library = Library(settings.cache_dir, settings.files)
        self._working_files = WorkingFiles(settings.data_dir, settings.files)
        self._store = ArtifactStore(settings.files)
        self._storage = Storage(settings.data_dir, self._store)
        self._memory = memory_limit(settings)
        self._seconds = settings.job_seconds - min(KEEPING_SECONDS, KEEPING_SHARE * settings.job_seconds)

    def run(self, attempt: Attempt) -> None:
        """Runs one attempt and records its outcome. Raises the errors of outages, and nothing is recorded."""
        record = self._record
        job = record.jobs.work(attempt.job_id)
        if job is None:
            return
        reporter = Reporter(record, attempt, seconds=self._seconds)
        try:
            if job.kind is JobKind.SELECTION:
                self._select(attempt, job, reporter)
            elif job.kind is JobKind.RERENDERING:
                self._rerender(attempt, job, reporter)
            else:
                self._attack(attempt, job, reporter)
        except Cancelled:
            cancelled = record.leases.standing(attempt) is Standing.CANCEL  # and it was not taken back
            record.leases.cancelled(attempt, self._left(attempt, job) if cancelled else ())
        except (Exception, SystemExit) as error:  # a plug-in's code may end the process it is run in
            if outage_of(error) is not None:
                raise
            if isinstance(error, InvalidRequest) and not job.checked:
                log.info("job rejected", error=str(error))
                record.leases.reject(attempt, error)
            else:
                failure = classify(error, self._memory)
                log.warning("job failed", kind=failure.kind, exc_info=error)
                record.leases.fail(attempt, failure.kind, failure.detail, self._left(attempt, job))
        self._working_files.forget(record, attempt.job_id)

    def _attack(self, attempt: Attempt, job: Job, reporter: Reporter) -> None:
        def checked(spec: JobSpec, warnings: Sequence[JobWarning]) -> None:
            if not job.checked:
                job.checked = True
                self._record.leases.checked(attempt, spec.model_dump(mode="json"), digest(spec), warnings)

        with self._working_files.attempt_directory(attempt) as out:
            with self._working_files.checkpoint(attempt) as checkpoint:
                self._go_on(attempt, checkpoint)
                result = execute(
                    parse(job.spec),
                    out,
                    self._library,
                    progress=reporter.progress,
                    cancelled=reporter.stop,
                    checkpoint=checkpoint,
                    checked=checked,
                )
            record = finite(result.model_dump(mode="json"))
            self._record.leases.succeed(attempt, record, outcome(result), self._stored(attempt, out))

    def _rerender(self, attempt: Attempt, job: Job, reporter: Reporter) -> None:
        """Fits a scene to an image. An attempt that follows another one begins again."""
        spec = RerenderingSpec.model_validate(job.spec)

        def tick(step: int, steps: int) -> None:
            reporter.progress(Progress(phase="analysing", step=step, steps=steps))
            if reporter.stop():
                raise Cancelled

        try:
            reporter.progress(Progress(phase="loading", steps=spec.fit.steps))
            data = self._given(attempt, SENT_IMAGE)
            if data is None:
                raise JobFailure("asset-missing", "the job's image is gone")
            image = decode_image(data, spec.scene.camera.size)
            rerendering, rendered = rerender_image(image, spec.attack(), spec.fit, self._library, tick)
        except (FileNotFoundError, Damaged) as error:
            raise JobFailure("asset-missing", f"the job's image is gone: {error}") from error
        rendering = png(rendered)
        view = RerenderingView(rerendering=rerendering, png=base64.b64encode(rendering).decode())
        with self._working_files.attempt_directory(attempt) as out:
            (out / RENDERING).write_bytes(rendering)
            files = self._stored(attempt, out)
            self._record.leases.succeed(attempt, finite(view.model_dump(mode="json")), {}, files)

    def _select(self, attempt: Attempt, job: Job, reporter: Reporter) -> None:
        """Finds the first answers to some views of a campaign."""
        probes = {view["number"]: parse(view["probe"]) for view in job.spec["views"]}
        asked = [View(number, None, 0, Member(probe.scene), probe, None) for number, probe in probes.items()]
        answers = []
        for answer in first_answers(asked, self._library, reporter.stop):
            answers.append(finite(answer.model_dump(mode="json")))
            self._record.leases.progress(attempt, "selecting", len(answers), len(asked), [])
        self._record.leases.succeed(attempt, {"answers": answers}, {}, [])

    def _go_on(self, attempt: Attempt, path: Path) -> None:
        """Writes the checkpoint that the job is to go on from, if it has one and has made none of its own yet."""
        if path.exists():
            return
        try:
            checkpoint = self._given(attempt, CHECKPOINT)
            if checkpoint is not None:
                disk.write(path, checkpoint)
        except (FileNotFoundError, Damaged) as error:
            log.warning("checkpoint gone, the job begins again", job=attempt.job_id, error=str(error))

    def _given(self, attempt: Attempt, name: str) -> bytes | None:
        """The bytes of a file that the job began with, or None. Raises FileNotFoundError and Damaged."""
        artifact = self._record.jobs.artifact(attempt.job_id, name)
        if artifact is None:
            return None
        with self._store.open(artifact.sha256) as file:
            return file.read()

    def _left(self, attempt: Attempt, job: Job) -> list[Artifact]:
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
                return self._stored(attempt, out)
        except OSError as error:
            log.warning("checkpoint not kept", job=attempt.job_id, error=str(error))
            return []

    def _stored(self, attempt: Attempt, out: Path) -> list[Artifact]:
        """The files of a directory, put into the store."""
        artifacts = [self._store.put(file) for file in sorted(out.iterdir())]
        for artifact in artifacts:
            artifact.job_id = attempt.job_id
        return artifacts


def classify(error: BaseException, memory: int) -> JobFailure:
    """The typed failure an exception amounts to, in a process that may have `memory` bytes."""
    if out_of_memory(error):
        return JobFailure("out-of-memory", f"the job needed {more_than(memory)}")
    if isinstance(error, JobFailure):
        return error
    if isinstance(error, InvalidRequest):
        # Preflight accepted the request, so something that it names has been removed since.
        return JobFailure("asset-missing", f"the request was valid when it was accepted, but is not any more: {error}")
    return JobFailure("internal", summary(error))


def answer(jobs: Jobs, attempt: Attempt) -> dict[str, Any]:
    """Runs an attempt; the answer to the worker has "outage", in words, if it has to be made again."""
    try:
        jobs.run(attempt)
    except Exception as error:
        outage = outage_of(error)
        if outage is None:
            raise
        log.warning("attempt ended by an outage", job=attempt.job_id, resource=outage.resource, exc_info=error)
        return {"outage": outage.detail}
    return {"done": attempt.job_id}


def abilities(values: Settings) -> Abilities:
    """Returns what this process has for jobs: device, networks and memory."""
    return Abilities(device().type, frozenset(TARGETS), memory_limit(values))


def main() -> None:
    """Loads network and OpenGL once, reports that it is ready, then runs jobs until its parent ends."""
    configure("job")
    give_way()
    values = Settings()
    connection = connect()
    inbox = requests(connection)
    log.info("warm", gl=warm_up(values))
    jobs = Jobs(values)
    reply(connection, {"ready": os.getpid(), "abilities": abilities(values).record()})
    for request in inbox:
        attempt = Attempt(request["job"], request["attempt"])
        with bound(job=attempt.job_id, attempt=attempt.number):
            result = answer(jobs, attempt)
        reply(connection, result)


if __name__ == "__main__":
    main()
