"""The schemas of the API's responses."""

import base64
import binascii
from datetime import datetime
from typing import Annotated, Any, Self

from pydantic import BaseModel, Field

from services.errors import InvalidRequest, without_folders
from services.extensions import Extension
from services.jobs.listed_job import ListedJob
from services.jobs.models import Artifact, Campaign, Job, State, times_of
from services.jobs.placement import Priority
from services.pipeline.outcome import Outcome
from services.pipeline.result import Result
from services.pipeline.spec import JobSpec
from services.pipeline.target_folders import TargetFolder
from services.pipeline.warning import JobWarning
from services.scenes.library import Entry


class BadField(BaseModel):
    """A field of a request with an invalid value."""

    field: str = Field(description='dotted path in the request, e.g. "scene.objects.0.mesh"')
    detail: str = Field(description="why the value is invalid, and which values are valid")


class ProgressView(BaseModel):
    """The progress of a job."""

    phase: str = Field(description='"loading", "attacking" or "analysing"')
    step: int
    steps: int = Field(description="largest number of steps")


class FailureView(BaseModel):
    """The reason for which a job failed."""

    kind: str = Field(
        description='"non-finite", "asset-missing", "out-of-memory", "worker-lost", "timeout", "target-unreachable" or '
        '"internal"'
    )
    detail: str


class JobSummary(BaseModel):
    """A job without its request and result, as lists show it."""

    id: str
    state: State = Field(description="succeeded means that it ran to its end, not that the network was fooled")
    created: datetime
    times: dict[str, datetime] = Field(description="for each state, the last time at which the job entered it")
    attempt: int = Field(description="number of attempts that were started")
    priority: Priority = Field(Priority.NORMAL, description="jobs of a higher priority are taken first")
    waiting: str | None = Field(
        None, description="why no live worker takes the queued job, if none of them has what it needs; else null"
    )
    seed: int
    progress: ProgressView | None
    title: str | None = Field(None, description="the name that a person gave the job; null if nobody has")
    tags: list[str] = Field(default_factory=list, description="the tags that people gave the job, sorted")
    retry_of: str | None = Field(None, description="id of the job whose request this one repeats; null if none")
    name: str = Field(description="the question, or the meshes of a job without one; of several questions their number")
    scene: str = Field(description="the meshes without their folders")
    attack: str = Field(description="renderer, parameter groups and method in short")
    renderer: str
    method: str
    target: str = Field(description="name of the network")
    question: str | None = Field(description="the first question; null for a job without one")
    checked: bool = Field(
        True,
        description="whether the scene was rendered and the network asked, before the job was accepted or by a worker "
        "since; `warnings` is empty and the request as it was sent until then",
    )
    warnings: list[JobWarning] = Field(default_factory=list, description="what the request was warned of")
    outcome: Outcome | None = Field(description="the part of the result that lists show, once the job succeeded")
    failure: FailureView | None
    errors: list[BadField] = Field(
        default_factory=list, description="the invalid fields of a job in the state rejected: its request cannot run"
    )

    @classmethod
    def listed(cls, job: ListedJob) -> Self:
        """The summary of a job in a list."""
        return cls(**_fields(job))


class JobView(JobSummary):
    """A job with its request and its result."""

    spec: Annotated[JobSpec | dict[str, Any], Field(union_mode="left_to_right")] = Field(
        description="the request with the values of all fields filled in; as it was stored, if its attack or renderer "
        "is not installed any more"
    )
    note: str | None = Field(None, description="what a person wrote about the job; null if nobody has")
    result: Result | None = Field(description="the result, once the job succeeded")

    @classmethod
    def of(cls, job: Job, with_result: bool = False) -> Self:
        """The view of a job in the database; `with_result` requires that the job was read with its result."""
        return cls(**_fields(job), spec=job.spec, note=job.note, result=job.result if with_result else None)


def _fields(job: Job | ListedJob) -> dict:  # type: ignore[type-arg]
    progress = failure = None
    if job.phase is not None:
        progress = {"phase": job.phase, "step": job.step, "steps": job.steps}
    if job.failure_kind is not None:
        failure = {"kind": job.failure_kind, "detail": job.failure_detail}
    return {
        "id": job.id,
        "state": job.state,
        "created": job.created_at,
        "times": times_of(job),
        "attempt": job.attempt,
        "priority": job.priority,
        "waiting": job.waiting if job.state is State.QUEUED else None,
        "seed": job.seed,
        "progress": progress,
        "title": job.title,
        "tags": job.tags or [],
        "retry_of": job.retry_of,
        "name": job.name,
        "scene": job.scene,
        "attack": job.attack,
        "renderer": job.renderer,
        "method": job.method,
        "target": job.target,
        "question": job.question,
        "checked": job.checked,
        "errors": job.errors or [],
        "warnings": job.warnings or [],
        "outcome": job.outcome,
        "failure": failure,
    }


class JobPage(BaseModel):
    """A page of the list of jobs."""

    items: list[JobSummary]
    next: str | None = Field(description="`cursor` of the page after this one; null on the last")
    previous: str | None = Field(None, description="`cursor` of the page before this one; null on the first")


class ArtifactView(BaseModel):
    """A file of a finished job."""

    name: str
    sha256: str = Field(description="SHA-256 of the file's bytes, which is also its ETag")
    media_type: str
    size: int = Field(description="bytes")

    @classmethod
    def of(cls, artifact: Artifact) -> Self:
        """The view of an artifact in the database."""
        return cls(name=artifact.name, sha256=artifact.sha256, media_type=artifact.media_type, size=artifact.size)


class ArtifactList(BaseModel):
    """The files of a job that has ended, or the checkpoint from which it is to go on."""

    items: list[ArtifactView]


class Uploaded(Entry):
    """An uploaded mesh or environment map."""

    thumbnail: str = Field(description="where its picture is, a PNG image")

    @classmethod
    def of(cls, entry: Entry) -> Self:
        """Returns the view of an upload."""
        return cls(**dict(entry), thumbnail=f"/v1/assets/{entry.name.removeprefix('sha256:')}/thumbnail")


class AssetList(BaseModel):
    """Uploaded meshes and environment maps."""

    items: list[Uploaded]


class SceneLibrary(BaseModel):
    """The meshes and environment maps that a scene can name."""

    meshes: list[Entry] = Field(description="the meshes that match the filters")
    environments: list[Entry] = Field(description="all environment maps")
    credits: list[str] = Field(description="creators and licences of the meshes and maps listed here")


class Health(BaseModel):
    """The answer of a process that is alive."""

    status: str


class ExtensionView(BaseModel):
    """A file of SCENE_ATTACK_EXTENSIONS, as the service loaded it."""

    file: str = Field(description="the file's name, without the folder")
    sha256: str | None = Field(description="SHA-256 of the file's bytes; null if it cannot be read")
    adds: list[str] = Field(description='kind and name of each registration, e.g. "renderer tint"')
    error: str | None = Field(description="the reason for which it was left out; null if it was loaded")

    @classmethod
    def of(cls, extension: Extension) -> Self:
        """The view of a loaded file."""
        adds = sorted(f"{kind} {name}" for kind, name in extension.adds)
        return cls(file=extension.name, sha256=extension.sha256, adds=adds, error=_shown(extension.error))


class TargetFolderView(BaseModel):
    """A folder of SCENE_ATTACK_TARGETS, as the service found it."""

    name: str
    card_sha256: str | None = Field(description="SHA-256 of the card's bytes; null if it has none that can be read")
    error: str | None = Field(description="the reason for which it is no target; null if it is one")

    @classmethod
    def of(cls, folder: TargetFolder) -> Self:
        """The view of a folder."""
        return cls(name=folder.name, card_sha256=folder.card_sha256, error=_shown(folder.error))


class Readiness(BaseModel):
    """Whether the service can take jobs and run them."""

    ready: bool
    database: bool = Field(description="whether the database answers")
    redis: bool = Field(description="whether Redis answers")
    storage: bool = Field(description="whether the data directory can be written and has space")
    worker: bool = Field(description="whether there is a worker")
    workers: int = Field(description="number of workers with a heartbeat in the last 15 seconds")
    extensions: list[ExtensionView] | None = Field(
        description="the extensions that this process loaded or left out; the service can be ready without the latter. "
        "null for a caller without a key"
    )
    targets: list[TargetFolderView] | None = Field(
        description="the networks of your own that this process registered or left out, one folder each; null likewise"
    )


def _shown(error: str | None) -> str | None:
    return None if error is None else without_folders(error)


def cursor_after(campaign: Campaign) -> str:
    """The cursor of the page that begins after this campaign."""
    return base64.urlsafe_b64encode(f"{campaign.created_at.isoformat()} {campaign.id}".encode()).decode().rstrip("=")


def read_cursor(cursor: str) -> tuple[datetime, str]:
    """The (created_at, id) after which the cursor's page begins. Raises InvalidRequest("cursor")."""
    try:
        time, job_id = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode().split(" ")
        place = datetime.fromisoformat(time)
        if place.tzinfo is None:
            raise ValueError("no time zone")
        if not job_id.isalnum():
            raise ValueError("no id")
    except (ValueError, binascii.Error) as error:
        raise InvalidRequest("cursor", "take it from `next` of the page before") from error
    return place, job_id
