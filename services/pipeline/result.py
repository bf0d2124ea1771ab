"""The record of a finished job: `result.json`, the API's `result`, and the content of the dashboard's job page."""

import operator

from pydantic import BaseModel, ConfigDict, Field

from services.analysis.records import Analyses, Answer, Attribution, HeldOver, Subset
from services.attacks.trace import TraceRow
from services.attacks.verdict import Verdict
from services.pipeline.question_record import QuestionResult
from services.pipeline.warning import JobWarning
from services.rendering.physical_change import Change
from services.rendering.plan import ImageError, Plan


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid")


BEST_SO_FAR = "best-so-far.json"
"""Name of the file with the best that an attack had found which was ended before its time."""
CHECKPOINT = "checkpoint.safetensors"
"""Name of the file with the state of such an attack, from which another job can go on."""


def subset_image(row: int) -> str:
    """The name of the file with the image of a row of `Result.subsets`, which the first and the last do not have: they
    are original.png and attacked.png.
    """
    return f"subset-{row}.png"


class Provenance(_Record):
    """The inputs and versions that reproduce the result bit for bit."""

    seed: int
    backend: str
    versions: dict[str, str]
    scene_sha256: str
    weights_sha256: str
    surrogate_sha256: str | None = Field(None, description="sha256 of the surrogate's weights, if the attack has one")
    meshes: dict[str, str] = Field(description="mesh name to sha256 of its file")
    credits: list[str] = Field(description="creators and licences of the models and maps shown")
    card_sha256: str | None = Field(None, description="sha256 of the card of a network of your own")
    extensions: dict[str, str] = Field(
        default_factory=dict,
        description="name to sha256 of the extension files that registered the method, a renderer or the target",
    )


class AtEpsilon(_Record):
    """The values of a group that are at its ε."""

    coordinates: int = Field(description="values within 5 % of ε")
    share: float = Field(description="their share of the group's values")


class Result(_Record):
    """The outcome of a job that ran to its end.

    fooled: the network's answer to the loop's image, truncated and rounded to 8 bits, met the goal. verified: its
    answer to the stored perturbation, rendered afresh by the exact path and rounded to 8 bits, meets the goal too. Only
    a verified perturbation is called an adversary, and only the outcome "fooled" counts as a success.
    """

    spec: dict[str, object]
    outcome: Verdict = Field(
        description="fooled: the answer was right, is wrong, and meets the goal; changed: nobody knows the right "
        "answer, and the new one meets the goal; became-right and still-wrong: the answer was wrong before the attack; "
        "held: none of these"
    )
    truth: list[str] = Field(
        default_factory=list, description="the labels that are right for the scene; empty if nobody knows them"
    )
    right_before: bool | None = Field(
        None, description="whether the answer to the original image was right; null if nobody knows"
    )
    fooled: bool
    verified: bool
    stopped: str = Field(description='why the loop ended: "verified", "steps", "queries" or "seconds"')
    leave: str | None = Field(description="the network's answer to the original image, if it is one to leave")
    labels_to_leave: list[str] = Field(
        default_factory=list, description="all labels that count as that answer: the truth, or those that mean the same"
    )
    reach: str | None
    warnings: list[JobWarning] = Field(default_factory=list)
    original: Answer
    attacked: Answer = Field(description="the answer to the exact image of the stored perturbation")
    in_loop: Answer = Field(description="the answer to the loop's image, truncated, at the stored step")
    float_perceptibility: float = Field(
        description="p(ΔY) of the exact image of the stored perturbation before it is rounded to 8 bits, which is the "
        "paper's p; in [0, √3]"
    )
    perceptibility: float = Field(
        description="p(ΔY) of the exact image of the stored perturbation as it is saved, rounded to 8 bits; in [0, √3]"
    )
    group_perceptibility: dict[str, float]
    at_epsilon: dict[str, AtEpsilon] = Field(
        {},
        description="for each attacked group with an ε: the values of the stored perturbation that are at it. Where a "
        "search held and some are, ε bound it, and nothing is said about perturbations beyond",
    )
    beyond_truncation: int | None = Field(
        description="pixels of the exact image with a value that differs from the original by more than U"
    )
    plan: Plan = Field(description="how the images inside the attack were rendered, and their estimated error")
    image_error: float = Field(
        description="measured error, a maximum: largest difference of a displayed value, in [0,1], between the images "
        "of the stored perturbation by the plan and by the exact renderer. `plan.error` is an estimate of it where "
        '`plan.error_is` is "maximum"; where it is "mean", as of rasterised images, it is no bound of it'
    )
    sampled_error: ImageError | None = Field(
        None,
        description="largest error seen on those images inside the attack that were rendered exactly too: "
        "`mean`, the mean absolute error of the displayed values of covered pixels, and "
        "`share`, the share of these pixels that are off by more than 1/255; null where no image was rendered twice",
    )
    environment_map_error: float | None = Field(
        None,
        description="the error of the environment map's resolution, not part of the plan's error: largest difference "
        "of a displayed value, at up to 256 pixels of each object of the original, from the same scene under a map of "
        "64×128; null if the renderer uses no map or one of that size",
    )
    subsets: list[Subset]
    attribution: Attribution = Field(description="Shapley values and interactions of the groups, from `subsets`")
    expectation: HeldOver | None = Field(
        None, description="the share of the attack's range of views, light and noise for which the adversary holds"
    )
    changes: list[Change] = Field(
        default_factory=list, description="what the stored perturbation did to the scene, in words and units"
    )
    analyses: Analyses = Field(Analyses(), description="the analyses that the request asked for")
    questions: list[QuestionResult] = Field(
        [], exclude_if=operator.not_, description="the questions about the image, their programs and their answers"
    )
    settings: dict[str, object] = Field(
        description="settings measured at the start of the attack, e.g. difference steps"
    )
    steps: int
    queries: int = Field(description="images that the target classified, verification included")
    surrogate_queries: int = Field(0, description="images that the surrogate classified, if the attack has one")
    renders: int
    truncated: int = Field(description="pixels that were truncated in at least one step")
    seconds: float
    step: int = Field(description="the step at which the stored perturbation was found")
    trace: list[TraceRow]
    provenance: Provenance

    @property
    def epsilon_bound(self) -> bool:
        """Whether any value of the stored perturbation is at its ε."""
        return any(group.coordinates for group in self.at_epsilon.values())
