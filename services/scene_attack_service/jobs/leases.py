"""Leases of jobs: the writes of a running attempt to the record, and the return of jobs whose attempt has ended early.
Here is also the only function that changes a job's state.

An attempt is fenced: its writes carry its number and change nothing once the job has been taken back, finished or
given to a later attempt.

Changes are counted, for the service's metrics. Counters say what the service has done since it was set up. They outlive
processes, machines and deleted jobs. A transaction collects what it counts, and adds it in one statement before it
commits: counters are rows that all processes change, so they are locked last, all in one order, and for a moment.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from enum import Enum
from typing import Any

from sqlalchemy import case, event, or_, select, update
from sqlalchemy.orm import Session
from sqlalchemy.sql.elements import ColumnElement

from scene_attack.errors import InvalidRequest, without_folders
from scene_attack.runs.result import JobWarning
from scene_attack_service.jobs.database import Database, insert, now
from scene_attack_service.jobs.models import Artifact, Event, Job, State, Total, listed, listed_outcome, not_paused
from scene_attack_service.jobs.uploads import titles, uploads_of

ACTIVE = (State.RUNNING, State.CANCELLING)
PHASES = ("loading", "selecting", "attacking", "analysing")
"""The phases of jobs, in their order."""
MAX_ATTEMPTS = 5
"""Attempts in a row whose process died before it had got further than those before, after which a job fails: so many
do not die by chance.
"""
DIED = "its process died or hung"
STAGE_BOUNDS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
"""Upper bounds of the histogram of a stage's time, in seconds; above them is one more class."""


@dataclass(frozen=True)
class Attempt:
    """The right to run a job and to write about it, until the lease lapses or the job moves on."""

    job_id: str
    number: int


class Standing(Enum):
    """Whether a running attempt should go on, stop because its job is cancelled, or stop because it lost the lease."""

    GO_ON = "go on"
    CANCEL = "cancel"
    LOST = "lost"


class Leases:
    """Leases of jobs, and the writes of the attempts that hold them."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def lease(self, job_id: str, owner: str, seconds: float) -> Attempt | None:
        """Leases a queued job to `owner` for `seconds`. Returns None if the job is not queued any more, e.g. because
        another worker was quicker, or if its campaign is paused.
        """
        with self._database.write() as session:
            job = change_state(
                session,
                job_id,
                State.RUNNING,
                [Job.state == State.QUEUED, not_paused()],
                attempt=Job.attempt + 1,
                lease_owner=owner,
                lease_until=now(session) + timedelta(seconds=seconds),
                phase=None,
                step=None,
                steps=None,
                waiting=None,
                phase_at=None,
            )
            return None if job is None else Attempt(job.id, job.attempt)

    def standing(self, attempt: Attempt) -> Standing:
        """Reads whether the attempt should go on."""
        with self._database.read() as session:
            row = session.execute(select(Job.state, Job.attempt).where(Job.id == attempt.job_id)).one_or_none()
        if row is None or row.attempt != attempt.number or row.state not in ACTIVE:
            return Standing.LOST
        return Standing.CANCEL if row.state == State.CANCELLING else Standing.GO_ON

    def renew(self, attempt: Attempt, seconds: float) -> Standing:
        """Extends the lease to `seconds` from now. Returns the attempt's standing."""
        with self._database.write() as session:
            until = now(session) + timedelta(seconds=seconds)
            session.execute(update(Job).where(*_fence(attempt)).values(lease_until=until))
        return self.standing(attempt)

    def progress(self, attempt: Attempt, phase: str, step: int, steps: int, rows: Sequence[dict[str, Any]]) -> bool:
        """Records the attempt's progress and the trace rows since its last report. Returns False if fenced off."""
        values: dict[str, Any] = {"phase": phase, "step": step, "steps": steps, "events": Job.events + 1}
        if rows:
            values |= _reached(rows[-1]["step"], rows[-1].get("queries", 0))
        with self._database.write() as session:
            mine = select(Job.phase, Job.phase_at).where(*_fence(attempt))
            before = session.execute(mine.with_for_update()).one_or_none()
            at = now(session)
            if before is not None and before.phase != phase:
                values["phase_at"] = at
            number = session.scalar(update(Job).where(*_fence(attempt)).values(values).returning(Job.events))
            if before is None or number is None:
                return False
            if before.phase != phase and before.phase_at is not None:
                count_stage(session, before.phase, (at - before.phase_at).total_seconds())
            data = {"phase": phase, "step": step, "steps": steps, "rows": list(rows)}
            session.add(Event(job_id=attempt.job_id, number=number, kind="progress", data=data, created_at=at))
            return True

    def succeed(
        self, attempt: Attempt, result: dict[str, Any], outcome: dict[str, Any], artifacts: Sequence[Artifact]
    ) -> bool:
        """Records the result, and the outcome of an attack; of other work it is empty. The artifacts' bytes must be in
        the store already. Returns False if fenced off.
        """
        reached = _reached(outcome["steps"], outcome["queries"]) | listed_outcome(outcome) if outcome else {}
        with self._database.write() as session:
            ended = self._end(session, attempt, State.SUCCEEDED, result=result, outcome=outcome, **reached)
            if ended:
                session.add_all(artifacts)
            return ended

    def fail(self, attempt: Attempt, kind: str, detail: str, artifacts: Sequence[Artifact] = ()) -> bool:
        """Ends the job with a typed failure, recorded without folders, and with the files of what it had found. Returns
        False if the attempt was fenced off.
        """
        why = {"failure_kind": kind, "failure_detail": without_folders(detail)}
        with self._database.write() as session:
            return self._end_early(session, attempt, State.FAILED, artifacts, **why)

    def reject(self, attempt: Attempt, error: InvalidRequest) -> bool:
        """Ends a job whose request cannot run. Returns False if the attempt was fenced off."""
        with self._database.write() as session:
            errors = [{"field": error.field, "detail": without_folders(error.detail)}]
            return self._end(session, attempt, State.REJECTED, errors=errors)

    def checked(self, attempt: Attempt, spec: dict[str, Any], digest: str, warnings: Sequence[JobWarning]) -> None:
        """Records that the request of the attempt's job can run: `spec` with what was left open filled in, its digest,
        and what its sender is warned of. Changes nothing if the attempt was fenced off.
        """
        warned = [warning.model_dump(mode="json") for warning in warnings]
        with self._database.write() as session:
            names = listed(spec, titles(session, uploads_of(spec)))
            values = {"checked": True, "spec": spec, "digest": digest, "warnings": warned, **names}
            session.execute(update(Job).where(*_fence(attempt)).values(values))

    def cancelled(self, attempt: Attempt, artifacts: Sequence[Artifact] = ()) -> bool:
        """Records that the attempt stopped because the job was cancelled, and the files of what it had found. Returns
        False if it was fenced off.
        """
        with self._database.write() as session:
            return self._end_early(session, attempt, State.CANCELLED, artifacts)

    def _end_early(
        self, session: Session, attempt: Attempt, to: State, artifacts: Sequence[Artifact], **values: Any
    ) -> bool:
        ended = self._end(session, attempt, to, **values)
        if ended:
            for artifact in artifacts:
                session.merge(artifact)  # a job that went on from a checkpoint has one already
        return ended

    def _end(self, session: Session, attempt: Attempt, to: State, **values: Any) -> bool:
        values |= {"lease_owner": None, "lease_until": None}
        return change_state(session, attempt.job_id, to, _fence(attempt)[1:], **values) is not None

    def give_back(self, attempt: Attempt) -> None:
        """Queues the job again when its worker is shut down. The attempt does not count as lost."""
        with self._database.write() as session:
            self._return(session, attempt, lost=0)

    def lose(self, attempt: Attempt, why: str = DIED) -> None:
        """Queues the job again after its attempt was lost, or fails it after `MAX_ATTEMPTS` such losses in a row that
        came before the attempt had got further than those before. `why` is the part of a sentence that says the reason.
        """
        with self._database.write() as session:
            self._return(session, attempt, lost=1, why=why)

    def take_back(self, owner: str | None = None) -> list[str]:
        """Ends all attempts whose lease has lapsed, or that the dead worker `owner` holds, as `lose` does. Returns the
        ids of their jobs.
        """
        with self._database.write() as session:
            gone = Job.lease_until < now(session)
            if owner is not None:
                gone = or_(gone, Job.lease_owner == owner)
            ended = select(Job.id, Job.attempt).where(Job.state.in_(ACTIVE), gone)
            # in one order, so that two supervisors that take jobs back at once wait for each other and never in a ring
            rows = session.execute(ended.order_by(Job.id).with_for_update()).all()
            for job_id, number in rows:
                self._return(session, Attempt(job_id, number), lost=1)
        return [job_id for job_id, _ in rows]

    def _return(self, session: Session, attempt: Attempt, *, lost: int, why: str = DIED) -> None:
        lock(session, attempt.job_id)
        fence = _fence(attempt)[1:]
        free: dict[str, Any] = {"lease_owner": None, "lease_until": None}
        job = session.get(Job, attempt.job_id)
        if job is None:
            return
        if lost:
            came = distance(job.phase, job.step)
            further = came > job.furthest
            free |= {"lost": 0 if further else job.lost + 1, "furthest": max(came, job.furthest)}
        if change_state(session, attempt.job_id, State.CANCELLED, [*fence, Job.state == State.CANCELLING], **free):
            return
        if lost:
            reason = {
                "failure_kind": "worker-lost",
                "failure_detail": f"{why}, {MAX_ATTEMPTS} times in a row without getting any further",
            }
            if free["lost"] >= MAX_ATTEMPTS:
                change_state(session, attempt.job_id, State.FAILED, fence, **free, **reason)
                return
        change_state(session, attempt.job_id, State.QUEUED, fence, **free, phase_at=None)


def _reached(step: int, queries: int) -> dict[str, Any]:
    """The columns of steps and queries that were done; an attempt that repeats some of them changes nothing."""
    counted = ((Job.steps_done, step), (Job.queries_done, queries))
    return {column.key: case((column < number, number), else_=column) for column, number in counted}


def distance(phase: str | None, step: int | None) -> int:
    """Progress of a job as a number that grows with its phases and steps; 0 before it has reported any."""
    return 0 if phase is None else (PHASES.index(phase) << 32) + (step or 0)


def _fence(attempt: Attempt) -> list[ColumnElement[bool]]:
    return [Job.id == attempt.job_id, Job.attempt == attempt.number, Job.state.in_(ACTIVE)]


def change_state(
    session: Session, job_id: str, to: State, where: Sequence[ColumnElement[bool]], **values: Any
) -> Job | None:
    """Changes a job's state if it meets the conditions `where`, and records the event; otherwise returns None."""
    lock(session, job_id)
    at = now(session)
    ended = {"ended_at": at} if to.terminal else {}
    changed = (
        update(Job)
        .where(Job.id == job_id, *where)
        .values({"state": to, f"{to.value}_at": at, "events": Job.events + 1, **ended, **values})
        .returning(Job)
        .execution_options(synchronize_session=False, populate_existing=True)
    )
    job = session.scalars(changed).one_or_none()
    if job is not None:
        session.add(Event(job_id=job_id, number=job.events, kind="state", data=story(job), created_at=at))
        if to is State.RUNNING and job.queued_at is not None:
            count_stage(session, "waiting", (at - job.queued_at).total_seconds())
        if to.terminal:
            count_end(session, job, None if job.phase_at is None else (at - job.phase_at).total_seconds())
    return job


def lock(session: Session, job_id: str) -> None:
    """Holds a job's row until the transaction ends, so that what is read of it stays true until it is changed.

    SQLite needs no such lock: it has one writer at a time.
    """
    session.execute(select(Job.id).where(Job.id == job_id).with_for_update())


def story(job: Job) -> dict[str, Any]:
    """The data of a state event: state and attempt; of a job that has ended the outcome, failure or bad fields."""
    data: dict[str, Any] = {"state": job.state.value, "attempt": job.attempt}
    if job.state == State.SUCCEEDED:
        data["outcome"] = job.outcome
    if job.state == State.REJECTED:
        data["errors"] = job.errors
    if job.state == State.FAILED:
        data["failure"] = {"kind": job.failure_kind, "detail": job.failure_detail}
    return data


def count(session: Session, name: str, label: str = "", by: float = 1) -> None:
    """Adds `by` to a counter when the transaction ends."""
    if not by:
        return
    if "totals" not in session.info:
        session.info["totals"] = Counter()
        event.listen(session, "before_commit", _write, once=True)
    session.info["totals"][name, label] += by


def count_stage(session: Session, stage: str, seconds: float) -> None:
    """Adds the time of a stage to its histogram when the transaction ends."""
    bound = bisect_left(STAGE_BOUNDS, seconds)
    count(session, "stage", f"{stage} {STAGE_BOUNDS[bound] if bound < len(STAGE_BOUNDS) else '+Inf'}")
    count(session, "stage_seconds", stage, max(seconds, 0.0))


def count_end(session: Session, job: Job, seconds: float | None) -> None:
    """Counts a job that has ended; `seconds` is the time since its last phase began, None if it had not begun."""
    count(session, "ended", f"{job.kind.value} {job.state.value}")
    if job.state is State.FAILED:
        count(session, "failures", job.failure_kind or "")
    count(session, "steps", by=job.steps_done)
    count(session, "queries", by=job.queries_done)
    if job.phase is not None and seconds is not None:
        count_stage(session, job.phase, seconds)


def _write(session: Session) -> None:
    counted: Counter[tuple[str, str]] = session.info.pop("totals")
    rows = [{"name": name, "label": label, "value": by} for (name, label), by in sorted(counted.items())]
    added = insert(session, Total).values(rows)
    values = {"value": Total.value + added.excluded.value}
    session.execute(added.on_conflict_do_update(index_elements=[Total.name, Total.label], set_=values))
