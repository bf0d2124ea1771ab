"""Submits the request of a job again, as a new job that names the first."""

from typing import Any

from api.state import Services, names_of
from services.access.caller import Caller
from services.errors import InvalidRequest
from services.jobs.models import Artifact, Job
from services.jobs.placement import Demand, Needs
from services.pipeline.names_known import check_names
from services.pipeline.spec import parse


def retry(
    services: Services, caller: Caller, job: Job, answer: Any, checkpoint: Artifact | None = None
) -> dict[str, Any]:
    """Queues a job with the request, priority, device and memory of `job`, which was read with its request, and returns
    `answer` of it. The new job belongs to the caller and to no campaign; a worker checks it before it runs. It goes on
    from `checkpoint`, a file of `job`, if given.

    Raises InvalidRequest if the request cannot run any more, and what `Submissions.submit` raises.
    """
    spec = parse(job.spec)
    check_names(spec, names_of(services, caller))
    try:
        needs = Needs.read(job.needs)
    except ValueError as error:
        raise InvalidRequest("job", str(error)) from error
    return services.submissions.submit(
        spec,
        None,
        answer,
        checked=False,
        owner=caller.owner,
        owner_queued=services.quotas.queued_of(caller.owner),
        demand=Demand(job.priority, needs.device, needs.memory),
        retry_of=job.id,
        checkpoint=checkpoint,
    )
