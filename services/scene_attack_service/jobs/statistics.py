"""Figures about the whole service, as its metrics report them, and what the record knows of each network."""

from collections import defaultdict
from dataclasses import dataclass, replace

from sqlalchemy import func, select

from scene_attack.analysis.campaign_table import Rate
from scene_attack.analysis.verdict import SUCCESS
from scene_attack_service.jobs.database import Database, now
from scene_attack_service.jobs.leases import STAGE_BOUNDS
from scene_attack_service.jobs.models import Campaign, Job, JobKind, State, Total, not_paused

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
    histograms = {}
    for stage, seconds in totals.pop("stage_seconds", {}).items():
        up_to, below = [], 0.0
        for bound in (*STAGE_BOUNDS, "+Inf"):
            below += totals["stage"].get(f"{stage} {bound}", 0)
            up_to.append((str(bound), below))
        histograms[stage] = StageTimes(up_to, seconds)
    totals.pop("stage", None)
    return histograms


@dataclass(frozen=True)
class TargetRecord:
    """The jobs of one network, of those that a caller may see."""

    jobs: int = 0
    open: int = 0
    """Jobs that have not ended."""
    right_before: int = 0
    """Jobs that ran to their end, on scenes that the network had right."""
    successes: int = 0
    """Jobs among `right_before` that fooled the network, verified."""
    weights_sha256: str | None = None
    """Hex SHA-256 of the weights of the newest job that ran to its end; None if there is none."""

    @property
    def rate(self) -> Rate:
        """The share of successes, with Wilson's 95 % interval."""
        return Rate.of_cases(self.successes, self.right_before)


class TargetRecords:
    """Reads the record by network."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def all(self, owner: str | None) -> dict[str, TargetRecord]:
        """The record of each network that a job of the owner names (None: of any owner), by the network's name."""
        own = [Job.kind == JobKind.ATTACK, Job.target.is_not(None), *([] if owner is None else [Job.owner == owner])]
        # The answers are columns of a subquery, as PostgreSQL does not group by an expression with a parameter.
        answers = (
            select(
                Job.target,
                Job.state,
                Job.outcome["outcome"].as_string().label("outcome"),
                Job.outcome["verified"].as_boolean().label("verified"),
                Job.outcome["right_before"].as_boolean().label("right_before"),
            )
            .where(*own)
            .subquery()
        )
        records: dict[str, TargetRecord] = {}
        with self._database.read() as session:
            query = select(*answers.columns, func.count().label("jobs")).group_by(*answers.columns)
            for row in session.execute(query).all():
                record = records.get(row.target, TargetRecord())
                counted = row.jobs if row.state is State.SUCCEEDED and row.right_before else 0
                records[row.target] = replace(
                    record,
                    jobs=record.jobs + row.jobs,
                    open=record.open + (0 if row.state.terminal else row.jobs),
                    right_before=record.right_before + counted,
                    successes=record.successes + (counted if row.verified and row.outcome == SUCCESS else 0),
                )
            for target in records:
                weights = (
                    select(Job.result["provenance"]["weights_sha256"].as_string())
                    .where(*own, Job.target == target, Job.state == State.SUCCEEDED)
                    .order_by(Job.created_at.desc())
                    .limit(1)
                )
                records[target] = replace(records[target], weights_sha256=session.scalar(weights))
        return records
