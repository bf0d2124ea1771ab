"""What people say about a job on its page (title, tags, note), and what they do with it: repeat or delete it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Form, Response
from fastapi.responses import RedirectResponse
from pydantic import ValidationError

from api.access.authentication import CallerDependency
from api.dashboard.pages import HEADERS
from api.schemas import JobEdit
from api.state import KnownJob, ServicesDependency, no_such
from services.errors import InvalidFields
from services.jobs.models import Job
from services.pipeline.field_errors import invalid_fields

router = APIRouter(include_in_schema=False)


@dataclass(frozen=True)
class About:
    """What a job's page shows of what people have said and done."""

    title: str | None
    tags: list[str]
    note: str | None
    retry_of: str | None
    retries: Sequence[str]
    """Ids of the jobs that repeat this one."""
    went_on: bool
    """Whether it began with the checkpoint of `retry_of`."""
    deletable: bool


def about(job: Job, retries: Sequence[str], went_on: bool) -> About:
    """What people have said about a job, and the jobs that repeat it."""
    deletable = job.state.terminal and job.campaign_id is None
    return About(job.title, job.tags or [], job.note, job.retry_of, retries, went_on, deletable)


@router.post("/jobs/{job_id}/about")
def edit(
    job: KnownJob,
    services: ServicesDependency,
    title: Annotated[str, Form()] = "",
    tags: Annotated[str, Form()] = "",
    note: Annotated[str, Form()] = "",
) -> Response:
    """Writes what the form on the page says; the tags have spaces or commas between them."""
    said = {"title": title.strip(), "tags": tags.replace(",", " ").split(), "note": note.replace("\r\n", "\n").strip()}
    try:
        changes = JobEdit.model_validate(said)
    except ValidationError as error:
        raise InvalidFields(invalid_fields(error.errors(include_url=False), JobEdit.model_json_schema())) from error
    services.record.lists.edit(job.id, changes.changes())
    return _to(f"/jobs/{job.id}")


@router.post("/jobs/{job_id}/retry")
def again(job: KnownJob, services: ServicesDependency, caller: CallerDependency) -> Response:
    """Queues the job's request again, and goes to the new job's page."""
    found = services.record.jobs.get(job.id)
    if found is None:
        raise no_such("job")
    return _to(f"/jobs/{services.submissions.retry(caller, found).id}")


@router.post("/jobs/{job_id}/delete")
def delete(job: KnownJob, services: ServicesDependency) -> Response:
    """Deletes a job that has ended, with its files, and goes to the list."""
    services.housekeeping.delete(job.id)
    return _to("/")


def _to(address: str) -> Response:
    return RedirectResponse(address, 303, HEADERS)
