"""Figures about the whole service, as its metrics report them: what is queued, what runs, and what was done."""

from collections import defaultdict
from dataclasses import dataclass

from sqlalchemy import func, select

from services.jobs.database import Database, now
from services.jobs.models import Campaign, Job, State, Total, not_paused
from services.jobs.totals import STAGE_BOUNDS

_ENDED = [state for state in State if state.terminal]


@dataclass(frozen=True)
class StageTimes:
    """The histogram of a stage: for each upper bound in seconds the times up to it, and the sum of all times."""

    up_to: list[tuple[str, float]]
    seconds: float


@dataclass(frozen=True)
class ServiceFigures:
    """The figures at one moment."""

    jobs: dict[tuple[str, str], int]
    """The number of jobs there are, by kind and state."""
    campaigns: dict[str, int]
    """The number of campaigns there are, by state."""
    queued: int
    """Queued jobs that may run: all but those of paused campaigns."""
    oldest_seconds: float
    """The time that the one of them has waited that has waited longest; 0 if there is none."""
    totals: dict[str, dict[str, float]]
    """Counters that never fall: label and value, by name."""
    stages: dict[str, StageTimes]


class Figures:
    """Reads the figures from the record."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def read(self) -> ServiceFigures:
        """The figures now. Raises SQLAlchemyError if the database does not answer."""
        with self._database.read() as session:
            if session.get_bind().dialect.name == "postgresql":  # so that all is read of one moment; SQLite does so
                session.connection(execution_options={"isolation_level": "REPEATABLE READ"})
            jobs = session.execute(select(Job.kind, Job.state, func.count()).group_by(Job.kind, Job.state)).all()
            campaigns = session.execute(select(Campaign.state, func.count()).group_by(Campaign.state)).all()
            waiting = select(func.count(), func.min(Job.queued_at)).where(Job.state == State.QUEUED, not_paused())
            queued, oldest = session.execute(waiting).one()
            totals: dict[str, dict[str, float]] = defaultdict(dict)
            for total in session.scalars(select(Total).order_by(Total.name, Total.label)):
                totals[total.name][total.label] = total.value
            active = select(func.sum(Job.steps_done), func.sum(Job.queries_done)).where(Job.state.not_in(_ENDED))
            for name, under_way in zip(("steps", "queries"), session.execute(active).one(), strict=True):
                totals[name][""] = totals[name].get("", 0) + int(under_way or 0)
            at = now(session)
        return ServiceFigures(
            jobs={(kind.value, state.value): n for kind, state, n in jobs},
            campaigns={state.value: n for state, n in campaigns},
            queued=queued,
            oldest_seconds=0.0 if oldest is None else max((at - oldest).total_seconds(), 0.0),
            totals=dict(totals),
            stages=_stages(totals),
        )


def _stages(totals: dict[str, dict[str, float]]) -> dict[str, StageTimes]:
    found = {}
    for stage, seconds in totals.pop("stage_seconds", {}).items():
        up_to, below = [], 0.0
        for bound in (*STAGE_BOUNDS, "+Inf"):
            below += totals["stage"].get(f"{stage} {bound}", 0)
            up_to.append((str(bound), below))
        found[stage] = StageTimes(up_to, seconds)
    totals.pop("stage", None)
    return found
