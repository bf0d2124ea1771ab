"""Uploads in the record: which jobs and campaigns refer to which, what the networks first answered to each mesh, and
the removal of those that were deleted.

A transaction that refers to a mesh holds the mesh's row until it ends, and so does one that deletes the mesh. Whichever
comes second therefore sees what the first one did: a job that names a deleted mesh is refused, and so is the deletion
of a mesh that a job names.
"""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session, defer
from sqlalchemy.sql.elements import ColumnElement

from scene_attack.errors import InUse, InvalidRequest
from scene_attack.runs.spec import scene_name
from scene_attack.scenes.library import Library
from scene_attack.scenes.scene_file import upload_of
from scene_attack_service.jobs.database import Database, insert, now
from scene_attack_service.jobs.models import Asset, Campaign, CampaignAsset, Job, JobAsset, JobKind, State

NAMED = 5
"""The most jobs, and the most campaigns, that an answer names."""


def uploads_of(spec: Mapping[str, Any]) -> dict[str, str]:
    """The uploads to which a job's spec refers, meshes and an environment map, each with the path where it is named
    first.
    """
    scene = spec["scene"]
    environment = ((scene.get("lights") or {}).get("environment") or {}).get("map") or ""
    places: dict[str, str] = {}
    for part in ("objects", "fixed"):
        for k, thing in enumerate(scene.get(part) or ()):
            places.setdefault(thing["mesh"], f"scene.{part}.{k}.mesh")
    places.setdefault(environment, "scene.lights.environment.map")
    uploads: dict[str, str] = {}
    for name, place in places.items():
        if name.startswith("sha256:"):
            uploads.setdefault(upload_of(name), place)
    return uploads


def hold(session: Session, names: Iterable[str], *, to_change: bool = False) -> frozenset[str]:
    """Holds uploads until the transaction ends, so that none is deleted meanwhile, nor referred to if they are held
    `to_change`. Returns those that were deleted.
    """
    asked = sorted(names)
    if not asked:
        return frozenset()
    session.execute(insert(session, Asset).values([{"name": name} for name in asked]).on_conflict_do_nothing())
    held = select(Asset.name, Asset.deleted_at).where(Asset.name.in_(asked)).order_by(Asset.name)
    rows = session.execute(held.with_for_update(read=not to_change)).all()
    return frozenset(row.name for row in rows if row.deleted_at is not None)


def check_held(session: Session, uploads: Mapping[str, str]) -> None:
    """Holds uploads. Raises InvalidRequest for one that was deleted; `uploads` has the path of each in the request."""
    for name in sorted(hold(session, uploads)):
        raise InvalidRequest(uploads[name], f"there is no upload {name!r} any more")


def titles(session: Session, names: Iterable[str]) -> dict[str, str]:
    """The titles of those of some uploads that have one, by name."""
    query = select(Asset.name, Asset.title).where(Asset.name.in_(sorted(names)), Asset.title.is_not(None))
    return {name: title for name, title in session.execute(query) if title is not None}


def refer_from_job(session: Session, job_id: str, names: Iterable[str]) -> None:
    """Records that a job refers to uploads."""
    session.add_all(JobAsset(job_id=job_id, name=name) for name in names)


def refer_from_campaign(session: Session, campaign_id: str, names: Iterable[str]) -> None:
    """Records that a campaign refers to uploads."""
    session.add_all(CampaignAsset(campaign_id=campaign_id, name=name) for name in names)


def check_unused(session: Session, name: str, owner: str | None, *, by_others: bool) -> None:
    """Raises InUse if a job or campaign of the owner refers to an upload, or if `by_others` anybody's. It names those
    of the owner only; the owner None is an administrator, who sees all.
    """
    jobs = select(Job.id).join(JobAsset, JobAsset.job_id == Job.id).where(JobAsset.name == name)
    campaigns = select(Campaign.id).join(CampaignAsset, CampaignAsset.campaign_id == Campaign.id)
    campaigns = campaigns.where(CampaignAsset.name == name)
    own_jobs = jobs if owner is None else jobs.where(Job.owner == owner)
    own_campaigns = campaigns if owner is None else campaigns.where(Campaign.owner == owner)
    users = [f"job {job_id}" for job_id in session.scalars(own_jobs.limit(NAMED))]
    users += [f"campaign {campaign_id}" for campaign_id in session.scalars(own_campaigns.limit(NAMED))]
    if users:
        raise InUse(f"it is in use by {', '.join(users)}")
    if by_others and (session.scalar(jobs.limit(1)) or session.scalar(campaigns.limit(1))):
        raise InUse("it is in use by a job or campaign of another owner")


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
        those of most jobs first. Meshes without an answer are left out, and so are jobs that ask something.
        """
        by_mesh: dict[str, list[FirstAnswer]] = defaultdict(list)
        with self._database.read() as session:
            # The answers are columns of a subquery, as PostgreSQL does not group by an expression with a parameter.
            answers = (
                select(
                    _MESH.label("mesh"),
                    Job.target,
                    Job.outcome["before"].as_string().label("before"),
                    Job.outcome["right_before"].as_boolean().label("right"),
                )
                .where(*_alone(session, meshes, owner), Job.asked.is_(None))
                .subquery()
            )
            count = func.count().label("jobs")
            query = select(*answers.columns, count).group_by(*answers.columns).order_by(count.desc(), *answers.columns)
            for row in session.execute(query).all():
                right = None if row.right is None else bool(row.right)
                by_mesh[row.mesh].append(FirstAnswer(row.target, row.before, right, row.jobs))
        return dict(by_mesh)

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
    named = titles(session, meshes)
    scenes = {scene_name({"scene": {"objects": [{"mesh": mesh}]}}, names) for mesh in meshes for names in ({}, named)}
    return [
        Job.kind == JobKind.ATTACK,
        Job.state == State.SUCCEEDED,
        Job.scene.in_(scenes),
        _MESH.in_(meshes),
        *([] if owner is None else [Job.owner == owner]),
    ]


REQUEST_SECONDS = 3600.0
"""Time for which it is remembered that a mesh was deleted: a request may have seen it before, and still be checked."""


class DeletedAssets:
    """The uploads that were deleted, and their files in a library."""

    def __init__(self, database: Database, library: Library) -> None:
        self._database = database
        self._library = library

    def remove(self, name: str) -> None:
        """Removes the files of an upload unless it is there again. Raises OSError; `remove_all` then does it later."""
        self._library.has_upload(name)  # raises OSError while the store is away, before anything waits for this
        with self._database.write() as session:  # until the files have gone, nobody can upload the mesh again
            if name in hold(session, [name], to_change=True):
                self._library.remove_upload(name)

    def remove_all(self) -> None:
        """Removes the files of all uploads that were deleted, and forgets those of long ago. Raises OSError."""
        with self._database.read() as session:
            before = now(session) - timedelta(seconds=REQUEST_SECONDS)
            names = session.scalars(select(Asset.name).where(Asset.deleted_at.is_not(None))).all()
        for name in names:
            self.remove(name)
        with self._database.write() as session:
            session.execute(delete(Asset).where(Asset.deleted_at < before))
