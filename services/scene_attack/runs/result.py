"""The records of a job. No torch is needed, so that the API can read them.

Before it runs: its warnings (`JobWarning`), its plan as `scene-attack plan` prints it (`JobPlan`), and its preview.
Once it has ended: `Result`, which is `result.json`, the API's `result`, and the content of the dashboard's job page.
`Outcome` is the part of a result that lists and tables of jobs show.
"""

import operator
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.analysis.records import Analyses, Answer, Attribution, HeldOver, Subset
from scene_attack.analysis.verdict import SUCCESS, Verdict
from scene_attack.attacks.trace import AttackCost, TraceRow
from scene_attack.rendering.physical_change import Change
from scene_attack.rendering.plan import ImageError, Plan
from scene_attack.runs.spec import JobSpec
from scene_attack.runs.task_parts import PlanParts, ResultPart, ResultParts
from scene_attack.strict import absent

LOW_CONFIDENCE = 0.5
"""Confidence of the first answer below which a job is warned of it: all other labels together are as probable."""


class JobWarning(BaseModel):
    """A warning about one field of an accepted request."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    code: Literal["already-wrong", "truth-unknown", "low-confidence", "left-out"]
    field: str = Field(description="the field of the request that it is about, e.g. `goal.truth`")
    text: str


def warnings(first: str, confidence: float, truth: tuple[str, ...], right: bool) -> tuple[JobWarning, ...]:
    """Returns the warnings about a network's first answer, given the true labels and whether the answer is right."""
    answer = f"{first!r} ({confidence:.2f})"
    result = []
    if not truth:
        text = f"nobody has said what this scene shows; the network says {answer}, and leaving that counts as “changed”"
        result.append(JobWarning(code="truth-unknown", field="goal.truth", text=text))
    elif not right:
        true = " or ".join(map(repr, truth))
        text = (
            f"the network gets this scene wrong before the attack: it says {answer}, not {true}; no success can follow"
        )
        result.append(JobWarning(code="already-wrong", field="goal.truth", text=text))
    if confidence < LOW_CONFIDENCE:
        text = f"the network is unsure of this scene before the attack: it says {answer}"
        result.append(JobWarning(code="low-confidence", field="scene", text=text))
    return tuple(result)


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid")


RESULT = "result.json"
"""Name of the file with the result."""
PERTURBATION = "perturbation.safetensors"
"""Name of the file with the stored perturbation."""
ATTACKED = "attacked.png"
"""Name of the file with its exact image."""
ORIGINAL = "original.png"
"""Name of the file with the exact image of the scene as it was."""
BEST_SO_FAR = "best-so-far.json"
"""Name of the file with the best that an attack had found which was ended before its time."""
CHECKPOINT = "checkpoint.safetensors"
"""Name of the file with the state of such an attack, from which another job can go on."""


def subset_image(row: int) -> str:
    """The name of the file with the image of a row of `Result.subsets`, which the first and the last do not have: they
    are original.png and attacked.png.
    """
    return f"subset-{row}.png"


class JobPlan(Plan):
    """The renderer's plan of a job, with what limits its search, and what its task adds."""

    tasks: PlanParts = Field({}, exclude_if=operator.not_, description="what the network's task adds, by its name")


class FirstAnswer(_Record):
    """The network's answer to the scene before the attack."""

    asked: str | None = Field(description="what was asked, in words; null where nothing is but what is seen")
    answer: Answer


class Preview(_Record):
    """A request as it would run, and the network's answers to the image of its scene."""

    spec: JobSpec = Field(description="the request with the values of all fields filled in")
    answers: tuple[FirstAnswer, ...] = Field(description="one answer; where several things are asked, one for each")
    warnings: tuple[JobWarning, ...] = Field(description="those that a job of this request would have")


class Cost(_Record):
    """What an attack costs, as far as it is known before. Both times were measured once, on this machine."""

    steps: int = Field(description="largest number of steps of an attempt; each has at least one image and one query")
    queries: int | None = Field(description="limit of network queries, if the request has one")
    image_seconds: float = Field(description="seconds of one image as the attack draws it, without its gradient")
    query_seconds: float = Field(description="seconds in which the network answers one image, without its gradient")
    least_seconds: float = Field(description="seconds of all steps if each had one image, one query and no gradient")


class PlannedCost(_Record):
    """The plan of a request, and its cost."""

    plan: JobPlan
    cost: Cost


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
    plugins: dict[str, str] = Field(
        default_factory=dict,
        description="name and version to sha256 of the module of each plug-in, of those that do not come with "
        "scene-attack, that registered the method, a renderer or the target",
    )


class AtEpsilon(_Record):
    """The values of a group that are at its ε."""

    coordinates: int = Field(description="values within 5 % of ε")
    share: float = Field(description="their share of the group's values")


class Noise(_Record):
    """How the verdict holds under other random numbers of a renderer whose images have noise."""

    seeds: int = Field(description="number of other seeds under which the exact image was drawn")
    share: float = Field(description="share of them under which the network's answer meets the goal; 1: all")
    standard_error: float = Field(
        description="of a displayed value of the exact image, in [0,1]: its standard deviation over the other seeds, "
        "the root of the mean square over the image"
    )

    @property
    def sentence(self) -> str:
        """The share and the standard error in words."""
        return (
            f"Drawn with {self.seeds} other seeds it meets the goal under {100 * self.share:.0f} %; the standard error "
            f"of a displayed value is {255 * self.standard_error:.2f}/255."
        )


class JobVerdict(_Record):
    """The goal as it was settled, and whether the attack met it.

    fooled: the network's answer to the loop's image, truncated and rounded to 8 bits, met the goal. verified: its
    answer to the stored perturbation, rendered afresh by the exact path and rounded to 8 bits, meets the goal too, and
    where images have noise it does so under every seed of `noise`. Only a verified perturbation is called an adversary,
    and only the outcome "fooled" counts as a success.
    """

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
    noise: Noise | None = Field(
        None, exclude_if=absent, description="where the renderer's images have noise: the verdict under other seeds"
    )


class StoredChange(_Record):
    """The stored perturbation: its size, and what it did to the scene."""

    step: int = Field(description="the step at which it was found")
    float_perceptibility: float = Field(
        description="p(ΔY) of its exact image before it is rounded to 8 bits, which is the paper's p; in [0, √3]"
    )
    perceptibility: float = Field(description="p(ΔY) of its exact image as it is saved, rounded to 8 bits; in [0, √3]")
    group_perceptibility: dict[str, float]
    at_epsilon: dict[str, AtEpsilon] = Field(
        {},
        description="for each attacked group with an ε: the values that are at it. Where a search held and some are, ε "
        "bound it, and nothing is said about perturbations beyond",
    )
    beyond_truncation: int | None = Field(
        description="pixels of the exact image with a value that differs from the original by more than U"
    )
    things: list[Change] = Field(
        default_factory=list, description="what it did to each object and light, in words and units"
    )

    @property
    def epsilon_bound(self) -> bool:
        """Whether any of its values is at its ε."""
        return any(group.coordinates for group in self.at_epsilon.values())


class Measured(_Record):
    """Values measured while the attack ran."""

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
    settings: dict[str, object] = Field(
        description="settings measured at the start of the attack, e.g. difference steps"
    )


class Result(_Record):
    """The outcome of a job that ran to its end."""

    spec: dict[str, object] = Field(description="the request as it ran, with all defaults filled in")
    verdict: JobVerdict
    warnings: list[JobWarning] = Field(default_factory=list)
    original: Answer
    attacked: Answer = Field(description="the answer to the exact image of the stored perturbation")
    in_loop: Answer = Field(description="the answer to the loop's image, truncated, at the stored step")
    change: StoredChange
    plan: Plan = Field(description="how the images inside the attack were rendered, and their estimated error")
    measured: Measured
    cost: AttackCost
    subsets: list[Subset]
    attribution: Attribution = Field(description="Shapley values and interactions of the groups, from `subsets`")
    expectation: HeldOver | None = Field(
        None, description="the share of the attack's range of views, light and cameras for which the adversary holds"
    )
    analyses: Analyses = Field(Analyses(), description="the analyses that the request asked for")
    tasks: ResultParts = Field({}, exclude_if=operator.not_, description="what the network's task adds, by its name")
    trace: list[TraceRow]
    provenance: Provenance

    @property
    def outcome(self) -> Verdict:
        """The verdict in one word; only "fooled" counts as a success."""
        return self.verdict.outcome

    @property
    def verified(self) -> bool:
        """Whether the answer to the stored perturbation, rendered afresh and rounded to 8 bits, meets the goal."""
        return self.verdict.verified

    @property
    def p(self) -> float:
        """The paper's p(ΔY) of the stored perturbation, in [0, √3]: of its exact image before it is rounded."""
        return self.change.float_perceptibility

    @property
    def findings(self) -> list[str]:
        """What the attack did to each thing in the scene, and for how much of its range and of the noise that holds, as
        sentences."""
        things = [f"{thing.subject}: {thing.sentence}" for thing in self.change.things]
        return [*things, *(about.sentence for about in (self.expectation, self.verdict.noise) if about is not None)]


class Outcome(BaseModel):
    """The verdict, the network's answers and the cost of a finished job."""

    model_config = ConfigDict(extra="forbid")

    outcome: Verdict = Field(description="what the attack came to; only `fooled` counts as a success")
    right_before: bool | None = Field(
        None, description="whether the answer to the original image was right; null if nobody knows"
    )
    fooled: bool = Field(description="whether the answer to an image inside the attack met the goal")
    verified: bool = Field(description="whether the answer to the perturbation rendered afresh meets the goal")
    stopped: str
    before: str = Field(description="label of the original image")
    before_confidence: float
    after: str = Field(description="label of the attacked image, rendered exactly")
    after_confidence: float
    answers: list[tuple[str, str]] = Field(
        [],
        exclude_if=operator.not_,
        description="of several answers attacked together: each before and after; `before` and `after` then say "
        "whether all of them have left",
    )
    float_perceptibility: float = Field(description="p of the image before rounding, the paper's")
    perceptibility: float = Field(description="p of the image as saved, of 8 bits")
    perceptibility_limit: float | None = Field(
        None, exclude_if=lambda limit: limit is None, description="the largest p that the request allowed"
    )
    epsilon_bound: bool = Field(
        False,
        exclude_if=operator.not_,
        description="whether some values of the stored perturbation are at their ε: a search that held was bound by it",
    )
    steps: int
    queries: int
    seconds: float


def success(record: Outcome | Result) -> bool:
    """Whether an attack succeeded: a scene that the network had right is wrong when the adversary is rendered afresh.

    Every rate and count of successes uses this and nothing else.
    """
    return record.outcome == SUCCESS and record.verified


def outcome(result: Result) -> dict[str, Any]:
    """The outcome of a result as JSON data, which the database stores beside the result."""
    request: Any = result.spec
    verdict, change, cost = result.verdict, result.change, result.cost
    return Outcome(
        outcome=verdict.outcome,
        right_before=verdict.right_before,
        fooled=verdict.fooled,
        verified=verdict.verified,
        stopped=verdict.stopped,
        before=result.original.label,
        before_confidence=result.original.confidence,
        after=result.attacked.label,
        after_confidence=result.attacked.confidence,
        answers=[pair for part in result.tasks.values() if isinstance(part, ResultPart) for pair in part.answers],
        float_perceptibility=change.float_perceptibility,
        perceptibility=change.perceptibility,
        perceptibility_limit=request["attack"].get("perceptibility"),
        epsilon_bound=change.epsilon_bound,
        steps=cost.steps,
        queries=cost.queries,
        seconds=cost.seconds,
    ).model_dump(mode="json")
