"""Which jobs and campaigns refer to which uploads.

A transaction that refers to a mesh holds the mesh's row until it ends, and so does one that deletes the mesh. Whichever
comes second therefore sees what the first one did: a job that names a deleted mesh is refused, and so is the deletion
of a mesh that a job names.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.errors import InUse, InvalidRequest
from services.jobs.asset_models import Asset, CampaignAsset, JobAsset
from services.jobs.models import Campaign, Job
from services.jobs.upsert import insert

NAMED = 5
"""The most jobs, and the most campaigns, that an answer names."""


def uploads_among(meshes: Iterable[str]) -> list[str]:
    """Those of some names of meshes that are of uploads, each once and sorted."""
    return sorted({name for name in meshes if name.startswith("sha256:")})


def uploads_of(spec: Mapping[str, Any]) -> list[str]:
    """The names of the uploads to which a job's spec refers: meshes, and an environment map."""
    scene = spec["scene"]
    environment = ((scene.get("lights") or {}).get("environment") or {}).get("map") or ""
    return uploads_among([*(thing["mesh"] for thing in scene["objects"]), environment])


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


def check_held(session: Session, names: Iterable[str], check_meshes: Callable[[Callable[[str], None]], None]) -> None:
    """Holds uploads and raises InvalidRequest for the field of one that was deleted.

    `check_meshes` calls the function it is given with every mesh of a request, and adds the field to its error.
    """
    deleted = hold(session, names)

    def check(name: str) -> None:
        if name in deleted:
            raise InvalidRequest("mesh", f"there is no upload {name!r} any more")

    if deleted:
        check_meshes(check)


def titles(session: Session, names: Iterable[str]) -> dict[str, str]:
    """The titles of those of some uploads that have one, by name."""
    found = select(Asset.name, Asset.title).where(Asset.name.in_(sorted(names)), Asset.title.is_not(None))
    return {name: title for name, title in session.execute(found) if title is not None}


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
    users = [f"job {one}" for one in session.scalars(own_jobs.limit(NAMED))]
    users += [f"campaign {one}" for one in session.scalars(own_campaigns.limit(NAMED))]
    if users:
        raise InUse(f"it is in use by {', '.join(users)}")
    if by_others and (session.scalar(jobs.limit(1)) or session.scalar(campaigns.limit(1))):
        raise InUse("it is in use by a job or campaign of another owner")
