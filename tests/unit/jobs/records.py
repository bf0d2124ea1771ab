"""Jobs in the record, without anything that would run them."""

from typing import Any

from scene_attack.runs.result import Outcome
from scene_attack.runs.spec import JobSpec, parse
from scene_attack_service.jobs.job_list import ListedJob, parse_query
from scene_attack_service.jobs.leases import Attempt
from scene_attack_service.jobs.models import Artifact, Job, State
from scene_attack_service.jobs.record import Record

SPEC = parse({"scene": {"objects": [{"mesh": "primitive/sphere"}]}, "seed": 7})
OUTCOME = Outcome(
    outcome="fooled",
    right_before=True,
    fooled=True,
    verified=True,
    stopped="verified",
    before="balloon",
    before_confidence=0.5,
    after="golf ball",
    after_confidence=0.4,
    float_perceptibility=0.0025,
    perceptibility=0.003,
    steps=1,
    queries=4,
    seconds=0.1,
).model_dump(mode="json")


def add(record: Record, spec: JobSpec = SPEC, *, checked: bool = True) -> Job:
    job, _ = record.jobs.create(spec, 1000, None, lambda job: {"id": job.id}, checked=checked)
    assert job is not None
    return job


def attacks(record: Record, query: str = "", owner: str | None = None) -> list[ListedJob]:
    """The attacks in the record that meet a query, newest first."""
    return list(record.lists.page(parse_query(query), 10_000, owner=owner).jobs)


def start(record: Record, job: Job, owner: str = "w", seconds: float = 20) -> Attempt:
    attempt = record.leases.lease(job.id, owner, seconds)
    assert attempt is not None
    return attempt


def artifact(job: Job, name: str = "result.json") -> Artifact:
    return Artifact(job_id=job.id, name=name, sha256="ab" * 32, media_type="application/json", size=3)


def row(record: Record, job: Job) -> dict[str, Any]:
    """Everything the record has of a job, to compare."""
    found = record.jobs.get(job.id, with_result=True)
    assert found is not None
    values = {column.name: getattr(found, column.name) for column in Job.__table__.columns}
    events = [(event.number, event.kind, event.data) for event in record.jobs.events(job.id, 0)]
    return values | {"events": events, "artifacts": [a.name for a in record.jobs.artifacts(job.id)]}


def state(record: Record, job_id: str) -> State:
    job = record.jobs.get(job_id)
    assert job is not None
    return job.state
