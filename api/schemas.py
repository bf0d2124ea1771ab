"""What the API says about jobs."""

import base64
import binascii
from datetime import datetime
from typing import Annotated, Any, Self

from pydantic import BaseModel, Field

from services.errors import InvalidRequest
from services.extensions import Extension
from services.jobs.models import Artifact, Job, State
from services.pipeline.outcome import Outcome
from services.pipeline.result import Result
from services.pipeline.spec import JobSpec
from services.scenes.library import Entry


class ProgressView(BaseModel):
    """How far a job is."""

    phase: str = Field(description='"loading", "attacking" or "analysing"')
    step: int
    steps: int = Field(description="most steps it may take")


class FailureView(BaseModel):
    """Why a job failed."""

    kind: str = Field(
        description='"non-finite", "asset-missing", "out-of-memory", "worker-lost", "timeout" or "internal"'
    )
    detail: str


class JobSummary(BaseModel):
    """A job as it is listed."""

    id: str
    state: State = Field(description="succeeded means that it ran to its end, not that the network was fooled")
    created: datetime
    times: dict[str, datetime] = Field(description="state to the last time it was entered")
    attempt: int = Field(description="times it was started")
    seed: int
    progress: ProgressView | None
    spec: Annotated[JobSpec | dict[str, Any], Field(union_mode="left_to_right")] = Field(
        description="the request with everything it left out filled in; as it was stored, where its attack or renderer "
        "is not installed any more"
    )
    outcome: Outcome | None = Field(description="the result in one line, once it succeeded")
    failure: FailureView | None

    @classmethod
    def of(cls, job: Job) -> Self:
        """The summary of a record."""
        return cls(**_fields(job))


class JobView(JobSummary):
    """A job with all it found."""

    result: Result | None = Field(description="once it succeeded")

    @classmethod
    def of(cls, job: Job, with_result: bool = False) -> Self:
        """The view of a record; a result is there only if it was read with it."""
        return cls(**_fields(job), result=job.result if with_result else None)


def _fields(job: Job) -> dict:  # type: ignore[type-arg]
    progress = failure = None
    if job.phase is not None:
        progress = {"phase": job.phase, "step": job.step, "steps": job.steps}
    if job.failure_kind is not None:
        failure = {"kind": job.failure_kind, "detail": job.failure_detail}
    return {
        "id": job.id,
        "state": job.state,
        "created": job.created_at,
        "times": job.times,
        "attempt": job.attempt,
        "seed": job.seed,
        "progress": progress,
        "spec": job.spec,
        "outcome": job.outcome,
        "failure": failure,
    }


class JobPage(BaseModel):
    """Some jobs, newest first."""

    items: list[JobSummary]
    next: str | None = Field(description="`cursor` of the page after this one; null on the last")


class ArtifactView(BaseModel):
    """A file of a finished job."""

    name: str
    sha256: str = Field(description="of its bytes; also its ETag")
    media_type: str
    size: int = Field(description="bytes")

    @classmethod
    def of(cls, artifact: Artifact) -> Self:
        """The view of a record."""
        return cls(name=artifact.name, sha256=artifact.sha256, media_type=artifact.media_type, size=artifact.size)


class ArtifactList(BaseModel):
    """The files of a job; none until it succeeded."""

    items: list[ArtifactView]


class AssetList(BaseModel):
    """Uploaded meshes."""

    items: list[Entry]


class SceneLibrary(BaseModel):
    """What a scene can name."""

    meshes: list[Entry] = Field(description="those that match the filters")
    environments: list[Entry] = Field(description="all environment maps")
    credits: list[str] = Field(description="creators and licences of everything listed here")


class Health(BaseModel):
    """A part that is well."""

    status: str


class ExtensionView(BaseModel):
    """A file of SCENE_ATTACK_EXTENSIONS, as the service loaded it."""

    file: str = Field(description="its name, without the folder")
    sha256: str | None = Field(description="of its bytes; null where it cannot be read")
    adds: list[str] = Field(description='kind and name of what it registers, e.g. "renderer tint"')
    error: str | None = Field(description="why it was left out; null if it was loaded")

    @classmethod
    def of(cls, extension: Extension) -> Self:
        """The view of a loaded file."""
        adds = sorted(f"{kind} {name}" for kind, name in extension.adds)
        return cls(file=extension.path.name, sha256=extension.sha256, adds=adds, error=extension.error)


class Readiness(BaseModel):
    """Whether the service can take jobs and run them."""

    ready: bool
    database: bool
    redis: bool
    workers: int = Field(description="workers that gave a sign of life in the last seconds")
    extensions: list[ExtensionView] = Field(
        description="as this process loaded them; the service is ready without those that were left out"
    )


def cursor_after(job: Job) -> str:
    """The cursor of the page that begins after this job."""
    return base64.urlsafe_b64encode(f"{job.created_at.isoformat()} {job.id}".encode()).decode().rstrip("=")


def read_cursor(cursor: str) -> tuple[datetime, str]:
    """The place a cursor stands for. Raises InvalidRequest("cursor")."""
    try:
        time, job_id = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode().split(" ")
        place = datetime.fromisoformat(time)
        if place.tzinfo is None:
            raise ValueError("no time zone")
    except (ValueError, binascii.Error) as error:
        raise InvalidRequest("cursor", "take it from `next` of the page before") from error
    return place, job_id
