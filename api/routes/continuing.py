"""Route that continues a job which ended before its time."""

from fastapi import APIRouter, HTTPException, Response

from api.authentication import CallerDependency
from api.schemas import JobView
from api.state import KnownJob, Services, ServicesDependency, no_such
from services.access.caller import Caller
from services.jobs.models import Job, State
from services.pipeline.result import CHECKPOINT

router = APIRouter(prefix="/v1/jobs", tags=["jobs"])


@router.post("/{job_id}/continue", status_code=202)
def continue_job(job: KnownJob, services: ServicesDependency, caller: CallerDependency, response: Response) -> JobView:
    """Queues a new job that goes on where one stopped that was cancelled or failed, in time, queries and steps.

    It has the same request and begins with the earlier job's file `checkpoint.safetensors`; its `retry_of` is that job,
    which stays as it is. On a machine with another renderer or network backend the attack begins again, as its steps
    would differ in their last bits. Answers 409 if the job has not ended, has succeeded, or ended before its first
    checkpoint.
    """
    queued = continued(job, services, caller)
    response.headers["Location"] = f"/v1/jobs/{queued.id}"
    return queued


def continued(job: Job, services: Services, caller: Caller) -> JobView:
    """Queues the job that goes on from another's checkpoint. Raises HTTPException as above."""
    if job.state not in (State.CANCELLED, State.FAILED):
        raise HTTPException(409, f"the job is {job.state.value}; one that was cancelled or failed can be continued")
    checkpoint = services.record.jobs.artifact(job.id, CHECKPOINT)
    if checkpoint is None:
        raise HTTPException(409, "the job ended before its first checkpoint; send its request again")
    first = services.record.jobs.get(job.id)
    if first is None:
        raise no_such("job")
    return services.submissions.retry(caller, first, checkpoint)
