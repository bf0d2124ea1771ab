"""Requests of analyses beyond what every result has, and the records of all analyses. It needs no torch."""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from scene_attack.analysis.verdict import Verdict, wilson
from scene_attack.rendering.physical_change import PhysicalChange
from scene_attack.rendering.sensor.settings import SensorRange
from scene_attack.strict import Model, absent, reference

Name = Annotated[str, Field(min_length=1, max_length=100)]
Steps = Annotated[int, Field(ge=1, le=10_000)]
By = Literal["coordinate", "object"]


def _by_coordinate(value: object) -> bool:
    return value == "coordinate"


class CoordinatesRequest(Model):
    """Shapley values of single coordinates; groups without named coordinates (pixels, texels) count as a whole."""

    by: By = Field(
        "coordinate",
        exclude_if=_by_coordinate,
        description="`object`: a part is all of a group that belongs to one object or light, such as `object 2 color`",
    )

    images: Annotated[int, Field(ge=4, le=1_000_000)] = Field(
        4096,
        description="largest number of images: enough for exact values of 12 coordinates; with more coordinates, or "
        "fewer images, values are means over random orders, with standard errors",
    )


class MinimalRequest(Model):
    """The smallest scale of the stored perturbation that still fools the network."""

    scans: Annotated[int, Field(ge=1, le=1000)] = Field(16, description="evenly spaced scales that are tried first")
    bisections: Annotated[int, Field(ge=0, le=30)] = Field(
        8, description="halvings of the interval below the first scale that fools"
    )


class TransferRequest(Model):
    """The stored perturbation's image before other networks."""

    targets: Annotated[tuple[Annotated[Name, reference("target")], ...], Field(min_length=1, max_length=16)] = Field(
        description="targets to show the image to"
    )


class SecondOpinionRequest(Model):
    """The changed scene, drawn by other renderers."""

    renderers: Annotated[tuple[Name, ...], Field(min_length=1, max_length=4)] = Field(
        description="renderers to draw the scene with, before and after, as far as the perturbation changes what they "
        "have"
    )


class InterpretationRequest(Model):
    """Fits of normals, illumination and material to the attacked image: 3 learning rates times 2 optimisers."""

    steps: Steps = Field(100, description="steps of each of the six fits")


class RerenderingRequest(Model):
    """The re-rendering defence: one fit of normals, illumination and material, and the answer to its rendering."""

    optimiser: Literal["sgd", "adam"] = Field("adam", description="the optimiser of the fit")
    rate: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] = Field(
        1e-3, description="its learning rate, in the units of each group"
    )
    steps: Steps = Field(100, description="its number of steps")


class AdaptiveRequest(Model):
    """An attack on the original image's pixels that knows the re-rendering defence; each step needs a fit."""

    steps: Annotated[int, Field(ge=1, le=1000)] = Field(10, description="largest number of steps")
    fit: RerenderingRequest = Field(RerenderingRequest(steps=30), description="the defence that it attacks")


class SurvivalRequest(SensorRange):
    """Whether a verified adversary still fools the network when cameras take its image, and not a file."""

    draws: Annotated[int, Field(ge=1, le=10_000)] = Field(64, description="cameras drawn from the range")


class AnalysisRequest(Model):
    """The analyses of the stored perturbation to make after the attack. Each is left out unless it is named; {} gives
    its defaults. Perceptibility, the table of subsets and the groups' Shapley values are in every result.
    """

    coordinates: CoordinatesRequest | None = Field(None, description="Shapley values of single coordinates")
    minimal: MinimalRequest | None = Field(None, description="the smallest scale that still fools")
    transfer: TransferRequest | None = Field(None, description="other targets")
    second_opinion: SecondOpinionRequest | None = Field(None, exclude_if=absent, description="other renderers")
    survival: SurvivalRequest | None = Field(
        None, exclude_if=absent, description="the share of cameras before which a verified adversary still fools"
    )
    interpretation: InterpretationRequest | None = Field(None, description="fits of physical parameters to the image")
    rerendering: RerenderingRequest | None = Field(None, description="the re-rendering defence")
    adaptive: AdaptiveRequest | None = Field(None, description="an attack through the re-rendering defence")


class Record(BaseModel):
    """Base class of the records, without unknown fields."""

    model_config = ConfigDict(extra="forbid")


class Answer(Record):
    """The network's answer to one image, rounded to 8 bits."""

    label: str
    index: int
    confidence: float = Field(description="probability of `label`")
    goal_probability: float = Field(
        description="probability of the goal's labels together (those to leave, or the one to reach)"
    )
    top: list[tuple[str, float]] = Field(description="the five most probable labels")


class Subset(Record):
    """The network's answer to the stored perturbation with only some of its groups applied, rendered exactly."""

    groups: list[str]
    label: str
    confidence: float
    goal_probability: float
    goal_log_odds: float = Field(description="log-odds of the goal's label")
    float_perceptibility: float = Field(description="p(ΔY) before the images are rounded to 8 bits, as the paper's")
    perceptibility: float = Field(description="p(ΔY) of the images as saved, of 8 bits")
    fooled: bool


class Shares(Record):
    """Shares of the parts in the effect of the whole perturbation on one quantity."""

    effect: float = Field(description="the quantity with the whole perturbation minus that of the original")
    shapley: list[float] = Field(description="each part's Shapley value; they sum to the effect")
    standard_error: list[float] | None = Field(None, description="of each Shapley value; null where they are exact")
    interactions: list[list[float]] | None = Field(
        None,
        description="Shapley interaction of each pair of parts, 0 on the diagonal: 0 where their contributions add up; "
        "null where Shapley values are sampled",
    )


class Attribution(Record):
    """Shapley values of a perturbation's parts: its groups, or single coordinates."""

    parts: list[str]
    method: Literal["exact", "sampled"]
    orders: int | None = Field(None, description="random orders of the parts that a sampled attribution is the mean of")
    images: int = Field(description="images rendered and classified for it, beside the original and the attacked one")
    log_odds: Shares = Field(description="of the log-odds of the goal's label")
    probability: Shares = Field(description="of the probability of the goal's label")


class RayPoint(Record):
    """The network's answer to the stored perturbation times a scale, rendered exactly."""

    scale: float
    label: str
    confidence: float
    goal_probability: float
    float_perceptibility: float = Field(description="p(ΔY) before the image is rounded, the paper's")
    perceptibility: float = Field(description="p(ΔY) of the image as saved, of 8 bits")
    fooled: bool


class MinimalChange(Record):
    """The smallest scale of the stored perturbation that was found to fool the network.

    Success need not be monotone along the ray: `smallest.scale` is below `fools_from` where a scanned scale between
    them holds, and what lies between two scanned scales is not known.
    """

    smallest: RayPoint | None = Field(
        description="the smallest scale found that fools, by a scan and a bisection; null if no scanned scale does"
    )
    holds_at: float = Field(description="the largest scale below it at which the network was seen to hold; 0: original")
    fools_from: float | None = Field(
        description="the smallest scanned scale from which on every scanned scale fools; null if scale 1 does not"
    )
    scan: list[RayPoint] = Field(description="the scanned scales, evenly spaced, the last is 1")
    images: int = Field(description="images rendered and classified")
    change: list[PhysicalChange] = Field(description="the perturbation at the smallest scale, in physical units")
    stored_change: list[PhysicalChange] = Field(description="the stored perturbation in physical units")


class Said(Record):
    """A network's answer to an image of 8 bits, in short."""

    label: str
    confidence: float


class Transferred(Record):
    """Answers of a network, asked in transfer, to the original and to the attacked image."""

    target: str
    before: Said
    after: Said
    outcome: Verdict = Field(description="what it came to, judged as for a job; only `fooled` counts as a success")
    right_before: bool | None = Field(
        description="whether the answer to the original was right; null if nobody knows what is right for this network"
    )


class SecondOpinion(Record):
    """The network's answers when another renderer draws the scene before and after."""

    renderer: str
    before: Said | None = None
    after: Said | None = None
    outcome: Verdict | None = Field(
        None, description="what it came to, judged as for a job; the adversary survives if it is `fooled`"
    )
    right_before: bool | None = Field(
        None, description="whether the answer to the scene before was right; null if nobody knows"
    )
    share: float | None = Field(
        None,
        description="share of other seeds under which the goal is met too; null where the images have no noise. The "
        "outcome is `held` unless it is 1",
    )
    note: str = Field("", description="what of the perturbation the images do not show, if they do not show all of it")
    failure: str | None = Field(None, description="why there is no opinion, if the renderer failed")


class Explanation(Record):
    """One fit of physical parameters to an image."""

    optimiser: str
    rate: float = Field(description="learning rate, of all groups")
    losses: list[float] = Field(description="mean absolute difference of a displayed value, at the start and each step")
    after: Said = Field(description="the answer to the exact rendering of the best fit")
    distance: float = Field(description="p of the difference between the image and that rendering, both of 8 bits")


class Interpretation(Record):
    """Fits of physical parameters to the attacked image: how well they explain it (paper, section 4.1.1)."""

    image: Said = Field(description="the answer to the attacked image")
    scene: Said = Field(description="the answer to the scene's own image, from which every fit starts")
    fits: list[Explanation]


class Rerendering(Record):
    """The re-rendering defence applied to one image."""

    optimiser: str
    rate: float
    losses: list[float]
    before: Said = Field(description="the answer to the image")
    after: Said = Field(description="the answer to the exact rendering of the scene fitted to it")
    distance: float = Field(description="p of the difference between the two images, both of 8 bits")


class AdaptiveAttack(Record):
    """An attack on pixels that knows the re-rendering defence (BPDA)."""

    fooled: bool = Field(description="whether the answer to the re-rendered image met the goal")
    steps: int
    goal_probability: list[float] = Field(
        description="probability of the goal's label for the re-rendered image, at the start and after each step"
    )
    image: Said = Field(description="the answer to the attacked image itself, without the defence")
    rerendered: Said = Field(description="the answer to its re-rendering")
    perceptibility: float = Field(description="p(ΔY) of the attacked image as saved, of 8 bits")


OnVariation = Literal["fooled", "held", "wrong"]


class SeenFrom(Record):
    """A fresh view of the scene, and the network's answer there."""

    azimuth: float = Field(description="of the camera, beyond the scene's own, degrees")
    elevation: float = Field(description="likewise")
    answer: OnVariation = Field(
        description="whether the perturbation fools the network there; `wrong`: its answer is wrong without it"
    )


class HeldOver(Record):
    """Success of the stored perturbation on fresh variations: over the range that its attack averaged over, each
    rendered by the exact path, or as cameras take its exact image. Intervals are Wilson's of 95 %.
    """

    variations: int = Field(description="fresh variations")
    right: int = Field(description="those whose clean image the network answers rightly; only these can be fooled")
    fooled: int = Field(description="of these, those whose attacked image it answers wrongly, as the goal wants")
    share: float | None = Field(description="fooled / right; null if the clean image was right nowhere")
    interval: tuple[float, float] | None
    views: list[SeenFrom] = Field(
        default_factory=list, description="the variations, where the camera goes around the scene; else empty"
    )
    wrong_share: float = Field(description="for comparison: share of all variations whose clean image is wrong already")
    wrong_interval: tuple[float, float]

    @classmethod
    def of(cls, answers: Sequence[OnVariation], views: Sequence[SeenFrom] = ()) -> "HeldOver":
        """Counts the answers on variations."""
        wrong, fooled = answers.count("wrong"), answers.count("fooled")
        right = len(answers) - wrong
        return cls(
            variations=len(answers),
            right=right,
            fooled=fooled,
            share=fooled / right if right else None,
            interval=wilson(fooled, right) if right else None,
            views=list(views),
            wrong_share=wrong / len(answers),
            wrong_interval=wilson(wrong, len(answers)),
        )

    @property
    def sentence(self) -> str:
        """How far it holds: "over its range it fools 21 of the 24 fresh variations that the network has right"."""
        return f"over its range it fools {self.fooled} of the {self.right} fresh variations that the network has right"


class Analyses(Record):
    """The analyses that the request asked for; null for those that it did not name."""

    coordinates: Attribution | None = None
    minimal: MinimalChange | None = None
    transfer: list[Transferred] | None = None
    second_opinion: list[SecondOpinion] | None = Field(
        None, exclude_if=absent, description="by renderer; null also where the adversary is not verified"
    )
    survival: HeldOver | None = Field(
        None,
        exclude_if=absent,
        description="the share of cameras before which the adversary fools; null also where it is not verified",
    )
    interpretation: Interpretation | None = None
    rerendering: Rerendering | None = None
    adaptive: AdaptiveAttack | None = None
