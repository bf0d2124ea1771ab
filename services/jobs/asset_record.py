"""What the record knows of a mesh: the networks' first answers to scenes that show it alone, and these jobs."""

from collections import defaultdict
from collections.abc import Collection
from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session, defer
from sqlalchemy.sql.elements import ColumnElement

from services.jobs.asset_uses import titles, uploads_among
from services.jobs.database import Database
from services.jobs.models import Job, JobKind, State
from services.pipeline.names import scene_name

_MESH = Job.spec[("scene", "objects", 0, "mesh")].as_string()


@dataclass(frozen=True)
class FirstAnswer:
    """A label that a network gave before the attack, and the number of jobs in which it did."""

    target: str
    label: str
    right: bool | None
    """Whether that was right; None if nobody has said what is."""
    jobs: int


class AssetRecords:
    """Reads the record by mesh."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def first_answers(self, meshes: Collection[str], owner: str | None) -> dict[str, list[FirstAnswer]]:
        """The first answers to each of these meshes in jobs of the owner (None: of any owner) that ran to their end,
        those of most jobs first. Meshes without an answer are left out, and so are jobs with questions.
        """
        found: dict[str, list[FirstAnswer]] = defaultdict(list)
        with self._database.read() as session:
            # The answers are columns of a subquery, as PostgreSQL does not group by an expression with a parameter.
            answers = (
                select(
                    _MESH.label("mesh"),
                    Job.target,
                    Job.outcome["before"].as_string().label("before"),
                    Job.outcome["right_before"].as_boolean().label("right"),
                )
                .where(*_alone(session, meshes, owner), Job.question.is_(None))
                .subquery()
            )
            count = func.count().label("jobs")
            query = select(*answers.columns, count).group_by(*answers.columns).order_by(count.desc(), *answers.columns)
            for row in session.execute(query).all():
                right = None if row.right is None else bool(row.right)
                found[row.mesh].append(FirstAnswer(row.target, row.before, right, row.jobs))
        return dict(found)

    def jobs(self, mesh: str, limit: int, owner: str | None) -> list[Job]:
        """At most `limit` jobs of the owner (None: of any owner) that ran to their end and show this mesh alone, newest
        first, without their results.
        """
        with self._database.read() as session:
            query = select(Job).where(*_alone(session, [mesh], owner)).options(defer(Job.result))
            return list(session.scalars(query.order_by(Job.created_at.desc(), Job.id.desc()).limit(limit)))


def _alone(session: Session, meshes: Collection[str], owner: str | None) -> list[ColumnElement[bool]]:
    """The conditions of a job that ran to its end and shows one of these meshes alone."""
    # Two meshes may have the same short name, and the name is a column: the request is read for few jobs only.
    named = titles(session, uploads_among(meshes))
    scenes = {scene_name({"scene": {"objects": [{"mesh": mesh}]}}, said) for mesh in meshes for said in ({}, named)}
    return [
        Job.kind == JobKind.ATTACK,
        Job.state == State.SUCCEEDED,
        Job.scene.in_(scenes),
        _MESH.in_(meshes),
        *([] if owner is None else [Job.owner == owner]),
    ]
