"""What a finished job says: `result.json`, the API's `result`, the dashboard's job page."""

from pydantic import BaseModel, ConfigDict, Field

from services.analysis.records import Answer, Subset
from services.attacks.trace import TraceRow
from services.rendering.image_error import ImageError
from services.rendering.plan import Plan


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Provenance(_Record):
    """What it takes to get the same bits again."""

    seed: int
    backend: str
    versions: dict[str, str]
    scene_sha256: str
    weights_sha256: str
    meshes: dict[str, str] = Field(description="mesh name to sha256 of its file")
    credits: list[str] = Field(description="creators and licences of the models and maps shown")
    extensions: dict[str, str] = Field(
        default_factory=dict, description="extension files the method, renderer or target came from, with their sha256"
    )


class Result(_Record):
    """The outcome of a job that ran to its end.

    fooled: inside the loop the (truncated, 8-bit) image was misclassified as the goal asks. verified: the stored
    perturbation, rendered afresh by the exact path and rounded to 8 bits, still is. Only a verified adversary counts.
    """

    spec: dict[str, object]
    fooled: bool
    verified: bool
    stopped: str = Field(description='why the loop ended: "verified", "steps", "queries" or "seconds"')
    leave: str | None
    reach: str | None
    original: Answer
    attacked: Answer = Field(description="the exact re-rendering of the stored perturbation")
    in_loop: Answer = Field(description="the loop's own, truncated image at the stored step")
    perceptibility: float = Field(description="p(ΔY) of the exact re-rendering")
    group_perceptibility: dict[str, float]
    beyond_truncation: int | None = Field(description="pixels of the exact re-rendering that moved more than U")
    plan: Plan = Field(description="how the images inside the attack were made, and the error that should cost")
    image_error: float = Field(
        description="the error it did cost: largest difference of a displayed value, in [0,1], between the stored "
        "perturbation rendered by the plan and exactly"
    )
    sampled_error: ImageError | None = Field(
        None,
        description="largest error seen on those images inside the attack that were rendered exactly too, of all since "
        "the job was last resumed: `mean`, the mean absolute error of the displayed values of covered pixels, and "
        "`share`, the share of these pixels that are off by more than 1/255; null where no image was rendered twice",
    )
    environment_map_error: float | None = Field(
        None,
        description="what the environment map's resolution costs beside: largest difference of a displayed value, at "
        "some pixels of the original, to the same scene under a map of 64×128; null where the renderer uses no map or "
        "one of that size",
    )
    subsets: list[Subset]
    settings: dict[str, object] = Field(description="settings found while running, e.g. measured difference steps")
    steps: int
    queries: int
    renders: int
    truncated: int = Field(description="pixels that were ever truncated")
    seconds: float
    step: int = Field(description="step whose perturbation is stored")
    trace: list[TraceRow]
    provenance: Provenance
