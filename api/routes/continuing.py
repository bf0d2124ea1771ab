"""Route that continues a job which ended before its time."""

from typing import Any

from fastapi import APIRouter, HTTPException, Response

from api.authentication import CallerDependency
from api.retries import retry
from api.schemas import JobView
from api.state import KnownJob, Services, ServicesDependency, no_such
from services.access.caller import Caller
from services.jobs.models import Job, State
from services.pipeline.result import CHECKPOINT

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


@router.post("/{job_id}/continue", status_code=202, response_model=JobView)
def continue_job(job: KnownJob, services: ServicesDependency, caller: CallerDependency, response: Response) -> Any:
    """Queues a new job that goes on where one stopped that was cancelled or failed, in time, queries and steps.

    It has the same request and begins with the earlier job's file `checkpoint.safetensors`; its `retry_of` is that job,
    which stays as it is. On a machine with another renderer or network backend the attack begins again, as its steps
    would differ in their last bits. Answers 409 if the job has not ended, has succeeded, or ended before its first
    checkpoint.
    """
    body = continued(job, services, caller)
    response.headers["Location"] = f"/v1/jobs/{body['id']}"
    return body


def continued(job: Job, services: Services, caller: Caller) -> dict[str, Any]:
    """Queues the job that goes on from another's checkpoint; returns its view. Raises HTTPException as above."""
    if job.state not in (State.CANCELLED, State.FAILED):
        raise HTTPException(409, f"the job is {job.state.value}; one that was cancelled or failed can be continued")
    checkpoint = services.repository.artifact(job.id, CHECKPOINT)
    if checkpoint is None:
        raise HTTPException(409, "the job ended before its first checkpoint; send its request again")
    first = services.repository.get(job.id)
    if first is None:
        raise no_such("job")
    return retry(services, caller, first, lambda made: JobView.of(made).model_dump(mode="json"), checkpoint)
