"""Whole attacks, as jobs run them: their success, visibility and work, with failures censored; and the
signs that FGSM takes from the gradient of a network's log-odds within each tolerance, against the exact ones.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, isfinite
from typing import Any, Literal

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.placing import placed
from services.accuracy.work_precision.shading import GROUPS, TOLERANCES
from services.attacks.attack import Attack
from services.attacks.fgsm import Fgsm
from services.attacks.goal import ResolvedGoal
from services.attacks.outcome import wilson
from services.attacks.problem import AttackProblem
from services.attacks.run import AttackRun, Verifier, run_attack
from services.attacks.zoo import Zoo
from services.rendering.color import as_saved
from services.rendering.factory import build
from services.rendering.plan import Tolerance
from services.rendering.protocol import Renderer
from services.scenes.resolve import ResolvedScene
from services.targets.labels import truth_labels
from services.targets.registry import card, load
from services.targets.scores import log_odds

NETWORK = "efficientnet-lite0"
SCENES = (
    ("furniture/folding-chair", "folding chair"),
    ("furniture/futon-couch", "studio couch"),
    ("furniture/pool-table", "pool table"),
    ("furniture/soccer-ball", "soccer ball"),
    ("furniture/grand-piano", "grand piano"),
    ("furniture/radiator3", "radiator"),
    ("furniture/video-projector", "projector"),
    ("furniture/rigged-fan", "electric fan"),
    ("furniture/helmet", "crash helmet"),
    ("furniture/filing-cabinet", "file"),
    ("furniture/speaker", "loudspeaker"),
    ("furniture/electric-guitar", "electric guitar"),
    ("furniture/little-lamp3", "table lamp"),
    ("furniture/upright-piano", "upright"),
    ("furniture/toilets-unit-jay-hardy", "toilet seat"),
    ("furniture/desk-officetable", "desk"),
    ("furniture/crib", "crib"),
    ("furniture/wardrobe-blend-swap-cc-by", "wardrobe"),
    ("furniture/barrel", "barrel"),
    ("furniture/washbasin-jay-hardy", "washbasin"),
    ("furniture/full-bookcase", "bookcase"),
    ("furniture/clock", "analog clock"),
    ("furniture/bath", "bathtub"),
    ("furniture/drill", "power drill"),
)
"""Furniture whose name is a label (benchmarks/views.json) and that the network gets right at the start with both
renderers, at the default camera. Chosen before any attack was run."""
COMBINED = ("normals", "illumination", "material")
FGSM_CASES: tuple[tuple[str, tuple[str, ...], tuple[Tolerance, ...]], ...] = (
    ("image", ("image",), ("exact",)),
    ("torch", ("normals",), (1e-3, "exact")),
    ("torch", ("illumination",), (1e-3,)),
    ("torch", ("material",), (1e-3,)),
    ("torch", COMBINED, (1e-2, 1e-3, "exact")),
)
"""Renderer, attacked groups and tolerances of FGSM. Exact attacks on light and on material alone are left out: they
hold until their last step, which costs more than all the others together."""
ZOO: dict[str, object] = {"learning_rate": 5e-3, "weight": 1e-3}
"""With λ = 0.1 and a rate of 0.002 every scene holds for as long as a report can wait."""

RESAMPLES = 4000
SEED = 0
"""Seed of the bootstrap."""

Outcome = Literal["verified", "fooled in the loop only", "held", "wrong to begin with"]


class AttackRow(BaseModel):
    """One attack. Where it held, `perceptibility` is that of the last image."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    label: str
    renderer: str
    method: str
    groups: tuple[str, ...]
    tolerance: Tolerance
    seed: int
    outcome: Outcome
    steps: int = 0
    max_steps: int = Field(description="steps allowed")
    queries: int = 0
    seconds: float = 0.0
    perceptibility: float | None = None
    advantages: list[float] = Field(
        default_factory=list, description="log-probability advantage before each step; below 0: fooled"
    )


@dataclass(frozen=True)
class Case:
    """An attack to be run."""

    scene: str
    label: str
    attack: Attack
    tolerance: Tolerance
    seed: int = 0


def cases(scenes: int, steps: int, zoo: dict[str, object]) -> list[Case]:
    """The attacks on the first `scenes`: FGSM on each set of groups and tolerance, and ZOO with the settings `zoo`."""
    runs = []
    for scene, label in SCENES[:scenes]:
        for renderer, groups, tolerances in FGSM_CASES:
            fgsm = Fgsm.model_validate({"renderer": renderer, "groups": groups, "steps": steps})
            runs += [Case(scene, label, fgsm, tolerance) for tolerance in tolerances]
        blind = Zoo.model_validate({"method": "zoo", "renderer": "pyrender"} | ZOO | zoo)
        runs.append(Case(scene, label, blind, 1e-3))
    return runs


def attack(case: Case) -> AttackRow:
    """Runs a case. A scene that the network gets wrong is not attacked."""
    target, settings = load(NETWORK), case.attack
    known: dict[str, Any] = {
        "scene": case.scene,
        "label": case.label,
        "renderer": settings.renderer,
        "method": settings.method,
        "groups": settings.groups,
        "tolerance": case.tolerance,
        "seed": case.seed,
        "max_steps": settings.steps,
    }
    scene = placed(case.scene, size=target_size(), lights={"environment": {"map": "studio", "size": (16, 32)}})
    renderer: Renderer = build(scene, settings.renderer, settings.base_renderer, settings.groups, case.tolerance)
    verifier = Verifier(renderer, target)
    goal = ResolvedGoal(_truth(case, target.labels), None)
    if bool(goal.fooled(verifier.logits(verifier.image({})))):
        return AttackRow(**known, outcome="wrong to begin with")
    problem = AttackProblem.of(
        renderer,
        target,
        goal,
        settings.groups,
        seed=case.seed,
        truncation=None if settings.truncation is None else settings.truncation / 255,
        distance_weight=settings.distance_weight,
        counts=verifier.counts,
    )
    run = run_attack(AttackRun.begin_or_resume(problem, settings, verifier))
    last = run.trace[-1]
    assert run.best is not None
    return AttackRow(
        **known,
        outcome=_outcome(run),
        steps=run.step,
        queries=last.queries,
        seconds=last.seconds,
        perceptibility=run.trace[run.best.step].perceptibility,
        advantages=[row.advantage for row in run.trace],
    )


def _truth(case: Case, labels: tuple[str, ...]) -> tuple[int, ...]:
    """Returns the case's label and its equivalents as indices; the attack must leave all of them."""
    truth = truth_labels(card(NETWORK), case.scene)
    return tuple(sorted(labels.index(name) for name in (truth if case.label in truth else (case.label,))))


def target_size() -> tuple[int, int]:
    """Height and width of the attacked images: the size the network was trained on."""
    return load(NETWORK).input_size


def _outcome(run: AttackRun) -> Outcome:
    if run.verified:
        return "verified"
    return "fooled in the loop only" if run.fooled else "held"


# Work to a verified adversary


class Interval(BaseModel):
    """A median and its 95 % bootstrap interval. null: beyond the budget of the attacks, as too many of them held."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    median: float | None
    low: float | None
    high: float | None


class SuccessRow(BaseModel):
    """All attacks of one method on one set of groups within one tolerance."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    renderer: str
    method: str
    groups: tuple[str, ...]
    tolerance: Tolerance
    attacks: int
    verified: int
    rate: float
    rate_low: float = Field(description="95 % interval of the rate (Wilson 1927)")
    rate_high: float
    max_steps: int = Field(description="an attack that is not verified by then is censored there")
    queries: Interval
    seconds: Interval
    queries_per_success: float | None = Field(description="all queries, failures included, by the number of successes")
    seconds_per_success: float | None
    seconds_per_step: float


def median_interval(values: Sequence[float]) -> Interval:
    """The median of values, of which some may be infinite (censored), and its percentile bootstrap interval.

    Medians are order statistics (the lower of the two middle ones), so that an infinite value never enters a mean.
    """
    sample = np.asarray(values, np.float64)
    random = np.random.default_rng(SEED)
    resampled = np.sort(sample[random.integers(0, len(sample), (RESAMPLES, len(sample)))], axis=1)
    medians = np.sort(resampled[:, (len(sample) - 1) // 2])
    low, high = medians[int(0.025 * RESAMPLES)], medians[int(0.975 * RESAMPLES)]
    numbers = (float(np.sort(sample)[(len(sample) - 1) // 2]), float(low), float(high))
    median, lowest, highest = (number if isfinite(number) else None for number in numbers)
    return Interval(median=median, low=lowest, high=highest)


def attacked_at_all(attacks: Sequence[AttackRow]) -> list[AttackRow]:
    """The attacks on scenes that the network got right; the others were not run."""
    return [row for row in attacks if row.outcome != "wrong to begin with"]


def success_rows(attacks: Sequence[AttackRow]) -> Iterator[SuccessRow]:
    """One row for each renderer, method, set of groups and tolerance."""
    rows = attacked_at_all(attacks)
    for kind in dict.fromkeys((r.renderer, r.method, r.groups, r.tolerance) for r in rows):
        own = [row for row in rows if (row.renderer, row.method, row.groups, row.tolerance) == kind]
        won = [row for row in own if row.outcome == "verified"]
        low, high = wilson(len(won), len(own))
        queries, seconds = (
            median_interval([float(getattr(r, work)) if r.outcome == "verified" else inf for r in own])
            for work in ("queries", "seconds")
        )
        yield SuccessRow(
            renderer=kind[0],
            method=kind[1],
            groups=kind[2],
            tolerance=kind[3],
            attacks=len(own),
            verified=len(won),
            rate=len(won) / len(own),
            rate_low=low,
            rate_high=high,
            max_steps=max(row.max_steps for row in own),
            queries=queries,
            seconds=seconds,
            queries_per_success=sum(r.queries for r in own) / len(won) if won else None,
            seconds_per_success=sum(r.seconds for r in own) / len(won) if won else None,
            seconds_per_step=sum(r.seconds for r in own) / max(1, sum(r.steps for r in own)),
        )


class SignRow(BaseModel):
    """Signs of one group's gradient through the network, as a step of FGSM takes them."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    map: tuple[int, int]
    group: str
    tolerance: Tolerance
    network: str = Field(description="number type of the network")
    image: str = Field(description="what the network saw when its gradient was taken: the image, or its 8 bits")
    coordinates: int = Field(description="whose gradient is not 0")
    wrong_signs: float = Field(description="share of coordinates whose sign is wrong")
    wrong_weight: float = Field(
        description="the same, each coordinate weighted by its part of the gradient's absolute sum"
    )


def sign_rows(mesh: str, label: str, size: tuple[int, int], texels: tuple[int, int]) -> Iterator[SignRow]:
    """The log-odds of `label` through plans for all groups at each tolerance, with the network's gradient at the
    image and at its 8 bits, as the attack's loop takes it; the reference is float64 throughout, at the image."""
    scene = placed(
        mesh, size=size, thing={"material": "glossy-paint"}, lights={"environment": {"map": "studio", "size": texels}}
    )
    number = load(NETWORK).labels.index(label)
    reference = _gradients(_renderer(scene, "exact"), number, torch.float64, rounded=False)
    for tolerance, rounded in product(TOLERANCES, (False, True)):
        gradients = _gradients(_renderer(scene, tolerance), number, torch.float32, rounded)
        for group in GROUPS:
            wrong = wrong_signs(gradients[group], reference[group])
            yield SignRow(
                mesh=mesh,
                map=texels,
                group=group,
                tolerance=tolerance,
                network="float32",
                image="8 bit" if rounded else "unrounded",
                coordinates=int((reference[group] != 0).sum()),
                wrong_signs=wrong.share,
                wrong_weight=wrong.weight,
            )


def _renderer(scene: ResolvedScene, tolerance: Tolerance) -> Renderer:
    built = build(scene, "torch", groups=GROUPS, tolerance=tolerance)
    return built.exact() if tolerance == "exact" else built


def _gradients(renderer: Renderer, number: int, dtype: torch.dtype, rounded: bool) -> dict[str, Tensor]:
    """Flat gradients of the log-odds by each group. `rounded` takes the network's at the 8-bit image, as the attack's
    loop does, and passes it straight through the rounding."""
    target = load(NETWORK, dtype)
    start = renderer.initial()
    leaves = {group: start[group].clone().requires_grad_() for group in renderer.plan.groups}
    image = renderer.render({group: leaf[None] for group, leaf in leaves.items()})
    seen = as_saved(image) if rounded else image.detach()
    seen = seen.to(dtype).requires_grad_()
    (by_image,) = torch.autograd.grad(log_odds(target.logits(seen), number).sum(), seen)
    gradients = torch.autograd.grad(image, list(leaves.values()), by_image.to(image.dtype))
    return {group: value.flatten().double() for group, value in zip(leaves, gradients, strict=True)}


@dataclass(frozen=True)
class WrongSigns:
    """share: fraction of the coordinates whose sign is wrong. weight: their fraction of the gradient's absolute sum; a
    step by the signs then gains 1 − 2 · weight of the gain with the right signs."""

    share: float
    weight: float


def wrong_signs(found: Tensor, wanted: Tensor) -> WrongSigns:
    """Measures the signs of estimates [..., n] of a gradient [n], over all coordinates that are not 0 in both.

    The sign of 0 is 0: a coordinate that is estimated as 0 and is not is wrong, and so is the converse, which weighs
    nothing.
    """
    wanted = wanted.expand_as(found)
    counted = (found != 0) | (wanted != 0)
    wrong = (found.sign() != wanted.sign()) & counted
    size, total = wanted.abs().double(), float(wanted.abs().double().sum())
    return WrongSigns(
        share=float(wrong.sum()) / max(1, int(counted.sum())),
        weight=float(size[wrong].sum()) / total if total else 0.0,
    )
