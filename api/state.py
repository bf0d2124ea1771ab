"""The objects that the routes use, of which each app has its own, and dependencies that provide them."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, HTTPException, Request

from api.access.authentication import CallerDependency
from api.checks import Checks, Exporter
from api.reading import Reading
from api.submissions import Submissions
from api.uploads import MeshUploads
from api.warm_pool import WarmPool
from api.watchers import ListWatcher, Watcher
from services.access.caller import Caller, OwnedAssets, Quotas
from services.access.keys import AccessKeys, Sessions
from services.jobs.campaigns import CampaignService
from services.jobs.files import ArtifactStore, Housekeeping, Storage
from services.jobs.models import Job
from services.jobs.queue import Queue
from services.jobs.record import Record
from services.jobs.uploads import DeletedAssets
from services.names import Names
from services.scenes.library import Library


@dataclass(frozen=True)
class Services:
    """Keys, sessions, uploads and quotas, the record of jobs and campaigns, the queue, the files, and what checks,
    previews, exports and watches.
    """

    keys: AccessKeys
    sessions: Sessions
    assets: OwnedAssets
    quotas: Quotas
    record: Record
    reading: Reading
    queue: Queue
    submissions: Submissions
    store: ArtifactStore
    library: Library
    pool: WarmPool
    checks: Checks
    uploads: MeshUploads
    exporter: Exporter
    campaigns: CampaignService
    watcher: Watcher
    list_watcher: ListWatcher
    storage: Storage
    housekeeping: Housekeeping
    deleted_assets: DeletedAssets


async def services(request: Request) -> Services:  # a function that is not async would be called in a thread
    """The app's services."""
    provided = request.app.state.services
    assert isinstance(provided, Services)
    return provided


ServicesDependency = Annotated[Services, Depends(services)]


async def known_job(job_id: str, services: ServicesDependency, caller: CallerDependency) -> Job:
    """The job with the id in the path, without request and result. Answers 404 if there is none for the caller."""
    job = caller.visible(await services.reading(services.record.jobs.line, job_id))
    if job is None:
        raise no_such("job")
    return job


KnownJob = Annotated[Job, Depends(known_job)]


def names_of(services: Services, caller: Caller) -> Names:
    """The context in which the names in a caller's request are looked up."""
    return services.submissions.names(caller)


def no_such(what: str) -> HTTPException:
    """The 404 error for a part of the path; `what` is its kind, e.g. "job"."""
    return HTTPException(404, f"there is no such {what}")
