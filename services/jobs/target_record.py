"""What the record knows of each network: how often attacks on it succeeded, and the weights that were attacked last."""

from dataclasses import dataclass, replace

from sqlalchemy import func, select

from services.analysis.campaign_table import Rate
from services.attacks.verdict import SUCCESS
from services.jobs.database import Database
from services.jobs.models import Job, JobKind, State


@dataclass(frozen=True)
class TargetRecord:
    """The jobs of one network, of those that a caller may see."""

    jobs: int = 0
    open: int = 0
    """Jobs that have not ended."""
    right_before: int = 0
    """Jobs that ran to their end, on scenes that the network had right."""
    successes: int = 0
    """Those of them that fooled the network, verified."""
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
        found: dict[str, TargetRecord] = {}
        with self._database.read() as session:
            query = select(*answers.columns, func.count().label("jobs")).group_by(*answers.columns)
            for row in session.execute(query).all():
                one = found.get(row.target, TargetRecord())
                counted = row.jobs if row.state is State.SUCCEEDED and row.right_before else 0
                found[row.target] = replace(
                    one,
                    jobs=one.jobs + row.jobs,
                    open=one.open + (0 if row.state.terminal else row.jobs),
                    right_before=one.right_before + counted,
                    successes=one.successes + (counted if row.verified and row.outcome == SUCCESS else 0),
                )
            for target in found:
                weights = (
                    select(Job.result["provenance"]["weights_sha256"].as_string())
                    .where(*own, Job.target == target, Job.state == State.SUCCEEDED)
                    .order_by(Job.created_at.desc())
                    .limit(1)
                )
                found[target] = replace(found[target], weights_sha256=session.scalar(weights))
        return found
