"""The schemas of the API's answers, and of the requests that are no job or campaign.

The Python client reads answers into them, so that nothing here imports the database or the framework.
"""

import re
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from scene_attack.analysis.records import RerenderingRequest
from scene_attack.client.states import CampaignState, JobKind, Priority, State
from scene_attack.errors import without_folders
from scene_attack.runs.campaign_plan import ChosenView
from scene_attack.runs.campaign_spec import CampaignSpec
from scene_attack.runs.result import Cost, JobPlan, JobWarning, Outcome, Preview, Result
from scene_attack.runs.spec import JobSpec, RerenderingSpec, RerenderingView, TargetChoice
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Entry
from scene_attack.strict import Model, Strict
from scene_attack.targets.info import TargetInfo
from scene_attack.text import line, line_or_nothing, paragraphs

if TYPE_CHECKING:
    from scene_attack.plugins import Plugin
    from scene_attack.runs.set_up import TargetFolder


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
    kind: JobKind = Field(JobKind.ATTACK, description="lists show a `rerendering` only if they are asked to")
    seed: int
    progress: ProgressView | None
    title: str | None = Field(None, description="the name that a person gave the job; null if nobody has")
    tags: list[str] = Field(default_factory=list, description="the tags that people gave the job, sorted")
    retry_of: str | None = Field(None, description="id of the job whose request this one repeats; null if none")
    name: str = Field(description="what is asked, in words, or the meshes of a job that asks nothing")
    scene: str = Field(description="the meshes without their folders")
    attack: str = Field(description="renderer, parameter groups and method in short")
    renderer: str
    method: str
    target: str = Field(description="name of the network")
    asked: str | None = Field(description="the first thing asked; null for a job that asks nothing")
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


class JobView(JobSummary):
    """A job with its request and its result."""

    spec: Annotated[JobSpec | RerenderingSpec | dict[str, Any], Field(union_mode="left_to_right")] = Field(
        description="the request with the values of all fields filled in; as it was stored, if its attack or renderer "
        "is not installed any more"
    )
    note: str | None = Field(None, description="what a person wrote about the job; null if nobody has")
    result: Annotated[Result | RerenderingView | None, Field(union_mode="left_to_right")] = Field(
        description="the result of an attack, or of a job of the kind `rerendering`, once it succeeded"
    )


class JobPage(BaseModel):
    """A page of the list of jobs."""

    items: list[JobSummary]
    next: str | None = Field(description="`cursor` of the page after this one; null on the last")
    previous: str | None = Field(None, description="`cursor` of the page before this one; null on the first")


class JobRow(BaseModel):
    """A line of the table of jobs. The fields from `outcome` to `seconds` are null until the job has succeeded."""

    id: str
    title: str | None = Field(description="the name that a person gave the job")
    name: str
    scene: str
    renderer: str
    method: str
    target: str
    asked: str | None
    state: State
    outcome: str | None
    verified: bool | None = Field(description="whether the adversary is a success: verified on the exact image")
    before: str | None = Field(description="what the network said before the attack")
    after: str | None = Field(description="what the network said after the attack")
    p: float | None = Field(description="perceptibility as a number, not in thousandths")
    queries: int | None
    seconds: float | None = Field(description="run time")
    seed: int
    tags: list[str]
    retry_of: str | None
    campaign: str | None
    created: datetime
    ended: datetime | None


class JobTable(BaseModel):
    """Every job that meets a query."""

    items: list[JobRow]


class ArtifactView(BaseModel):
    """A file of a finished job."""

    name: str
    sha256: str = Field(description="SHA-256 of the file's bytes, which is also its ETag")
    media_type: str
    size: int = Field(description="bytes")


class ArtifactList(BaseModel):
    """The files of a job that has ended, or the checkpoint from which it is to go on."""

    items: list[ArtifactView]


class PreviewView(Preview):
    """The preview of a request."""

    png: str = Field(description="the image of the scene as a PNG file in base64")
    plan: JobPlan | None = Field(description="how the attack's images would be made; null if it was not asked for")
    cost: Cost | None = Field(description="what the attack costs; null without the plan")


class ImageOfScene(Model):
    """An image: its bytes, or a file of a finished job."""

    data: str | None = Field(None, description="a PNG, JPEG or WebP file in base64, of the size of the scene's camera")
    job: str | None = Field(None, max_length=100, description="the id of a finished job")
    artifact: str = Field("attacked.png", max_length=100, description="the name of the job's file")

    @model_validator(mode="after")
    def _one_of_two(self) -> "ImageOfScene":
        if (self.data is None) == (self.job is None):
            raise ValueError("give either `data` or `job`")
        return self


class RerenderingBody(Model):
    """An image of a known scene, and the network to defend."""

    image: ImageOfScene
    scene: Scene | None = Field(None, description="the scene of the image; default: that of the job, if one is given")
    target: TargetChoice | None = Field(None, description="the network; default: that of the job, else the default one")
    fit: RerenderingRequest = RerenderingRequest()


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


class TargetList(BaseModel):
    """The networks that can be attacked."""

    items: list[TargetInfo]


class Health(BaseModel):
    """The answer of a process that is alive."""

    status: str


class PluginView(BaseModel):
    """An installed plug-in, as the service loaded it."""

    name: str
    package: str = Field(description="name and version of its package")
    sha256: str | None = Field(description="SHA-256 of its module's file; null if it was left out")
    adds: list[str] = Field(description='kind and name of each registration, e.g. "renderer tint"')
    error: str | None = Field(description="the reason for which it was left out; null if it was loaded")

    @classmethod
    def of(cls, plugin: "Plugin") -> Self:
        """The view of a plug-in."""
        return cls(
            name=plugin.name,
            package=plugin.package,
            sha256=plugin.sha256,
            adds=plugin.registered,
            error=_shown(plugin.error),
        )


class TargetFolderView(BaseModel):
    """A folder of SCENE_ATTACK_TARGETS, as the service found it."""

    name: str
    card_sha256: str | None = Field(description="SHA-256 of the card's bytes; null if it has none that can be read")
    error: str | None = Field(description="the reason for which it is no target; null if it is one")

    @classmethod
    def of(cls, folder: "TargetFolder") -> Self:
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
    plugins: list[PluginView] | None = Field(
        description="the plug-ins that this process loaded or left out; the service can be ready without the latter. "
        "null for a caller without a key"
    )
    targets: list[TargetFolderView] | None = Field(
        description="the networks of your own that this process registered or left out, one folder each; null likewise"
    )


def _shown(error: str | None) -> str | None:
    return None if error is None else without_folders(error)


class CampaignProgress(BaseModel):
    """How far a campaign is: first in views, then in jobs."""

    views: int = Field(description="views that the networks are asked for")
    answered: int = Field(description="views whose first answer is known")
    jobs: int = Field(description="jobs on the chosen views; 0 until they are chosen")
    ended: int = Field(description="jobs that have ended")
    running: int = Field(description="jobs and parts of the selection that are running now")


class CampaignSummary(BaseModel):
    """A campaign, as lists show it."""

    id: str
    name: str
    state: CampaignState = Field(description="finished means that all its jobs have ended, however they did")
    created: datetime
    selected: datetime | None = Field(description="the time at which the views were chosen")
    paused: datetime | None
    ended: datetime | None
    failure: str | None = Field(
        description="why the service paused the campaign, whose request it cannot read as it is"
    )
    progress: CampaignProgress


class CampaignView(CampaignSummary):
    """A campaign with its request and its results so far."""

    spec: Annotated[CampaignSpec | dict[str, Any], Field(union_mode="left_to_right")] = Field(
        description="the request with the values of all fields filled in"
    )
    chosen: int = Field(description="views that are attacked; 0 until they are chosen")
    outcomes: dict[str, int] = Field(description="number of jobs of each outcome so far")
    successes: int = Field(description="jobs so far that fooled a network that was right, verified")
    reused: int = Field(description="jobs so far whose result was there already")
    seconds_left: float | None = Field(description="estimated from the jobs that have ended; null before that")


class CampaignPage(BaseModel):
    """A page of the list of campaigns, newest first."""

    items: list[CampaignSummary]
    next: str | None = Field(description="`cursor` of the page after this one; null on the last")


class ViewList(BaseModel):
    """All views of a campaign, with the networks' first answers; empty until they are known."""

    items: list[ChosenView]


class CampaignJobView(BaseModel):
    """A job that a campaign has planned."""

    number: int
    target: str
    attack: str = Field(description="name of the attack in the campaign")
    view: int = Field(description="number of the view")
    job: str | None = Field(description="id of the job; null until it is queued")
    state: State | None = Field(description="state of the job; null until it is queued")
    reused: bool = Field(description="whether the job is an earlier one of the same request")
    outcome: Outcome | None = Field(description="the job's outcome, once it succeeded")


class CampaignJobPage(BaseModel):
    """A page of a campaign's jobs, in the order in which they are queued."""

    items: list[CampaignJobView]
    next: int | None = Field(description="`after` of the page after this one; null on the last")


TAG_PATTERN = re.compile(r'[^\s,:"\x00-\x1f\x7f-\x9f]{1,50}')
TAG_WORDS = "a tag has 1 to 50 characters, without spaces, commas, colons and quotation marks"
MOST_TAGS = 20


def _tag(text: str) -> str:
    if TAG_PATTERN.fullmatch(line(text)) is None:
        raise ValueError(f"{TAG_WORDS}, not {text[:60]!r}")
    return text


Tag = Annotated[str, Field(json_schema_extra={"pattern": f"^{TAG_PATTERN.pattern}$"}), AfterValidator(_tag)]


def is_tag(text: str) -> bool:
    """Whether a job may have this tag."""
    try:
        _tag(text)
    except ValueError:
        return False
    return True


class JobEdit(Strict):
    """Changes of what people have said about a job. Fields that are left out stay as they are."""

    model_config = ConfigDict(extra="forbid")

    title: Annotated[str, Field(max_length=100), AfterValidator(line_or_nothing)] | None = Field(
        None, description='a name that a person gives the job; "" or null for none'
    )
    tags: Annotated[list[Tag], Field(max_length=MOST_TAGS)] | None = Field(
        None, description="all tags of the job, each without spaces, commas, colons and quotation marks; null for none"
    )
    note: Annotated[str, Field(max_length=10_000), AfterValidator(paragraphs)] | None = Field(
        None, description='a text; "" or null for none'
    )

    def changes(self) -> dict[str, object]:
        """The columns to write."""
        values = {name: getattr(self, name) for name in self.model_fields_set}
        return {name: (value or []) if name == "tags" else value or None for name, value in values.items()}
