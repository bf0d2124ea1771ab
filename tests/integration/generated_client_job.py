"""A program of another project, with the client `generated`. The arguments are a URL and a file of examples."""

import json
import sys
from pathlib import Path

from generated import Client
from generated.api.artifacts import download_artifact, list_artifacts
from generated.api.jobs import get_job, stream_job_events, submit_job
from generated.models import JobSpec, ProblemDetails

client = Client(base_url=sys.argv[1], timeout=300)
request = json.loads(Path(sys.argv[2]).read_text())["submit_job"]["request"]
job = submit_job.sync(client=client, body=JobSpec.from_dict(request))
stream_job_events.sync_detailed(job.id, client=client)  # which end with the job
job = get_job.sync(job.id, client=client)
image = next(one for one in list_artifacts.sync(job.id, client=client).items if one.name == "attacked.png")
image_bytes = download_artifact.sync(job.id, image.name, client=client).payload.read()
waited = submit_job.sync(client=client, body=JobSpec.from_dict(request), prefer="wait=30")

misspelt = JobSpec.from_dict({"scene": {"objects": [{"mesh": "furniture/sofaa"}]}})
problem = submit_job.sync(client=client, body=misspelt)
assert isinstance(problem, ProblemDetails)

outcome = {
    "state": job.state,
    "outcome": job.outcome.outcome,
    "after": job.outcome.after,
    "image complete": len(image_bytes) == image.size,
    "again": waited.id != job.id,
    "problem": (problem.status, problem.errors[0].field),
}
print(json.dumps(outcome))
