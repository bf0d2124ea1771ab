"""Whole attacks, as jobs run them: their success, visibility and work, with failures censored."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from statistics import median_low
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.placing import placed
from services.analysis.verdict import wilson
from services.attacks.attack import Attack
from services.attacks.fgsm import Fgsm
from services.attacks.goal import ResolvedGoal
from services.attacks.limits import Limits
from services.attacks.problem import AttackProblem
from services.attacks.run import AttackRun, Verifier, run_attack
from services.attacks.zoo import Zoo
from services.rendering.factory import build
from services.rendering.plan import Tolerance
from services.rendering.protocol import Renderer
from services.targets.labels import truth_labels
from services.targets.registry import card, load

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

Outcome = Literal["verified", "fooled in the loop only", "held", "wrong to begin with"]


class AttackRow(BaseModel):
    """One attack. Where it held, `perceptibility` is that of the last image. Its seed is 0."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    label: str
    renderer: str
    method: str
    groups: tuple[str, ...]
    tolerance: Tolerance
    outcome: Outcome
    steps: int = 0
    max_steps: int = Field(description="steps allowed")
    queries: int = 0
    seconds: float = 0.0
    perceptibility: float | None = None


@dataclass(frozen=True)
class Case:
    """An attack to be run."""

    scene: str
    label: str
    attack: Attack
    tolerance: Tolerance


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
    """Runs a case: the attack must leave its label and its equivalents. A scene that the network gets wrong is not
    attacked."""
    target, settings = load(NETWORK), case.attack
    known: dict[str, Any] = {
        "scene": case.scene,
        "label": case.label,
        "renderer": settings.renderer,
        "method": settings.method,
        "groups": settings.groups,
        "tolerance": case.tolerance,
        "max_steps": settings.steps,
    }
    scene = placed(case.scene, size=target.input_size, lights={"environment": {"map": "studio", "size": (16, 32)}})
    renderer: Renderer = build(scene, settings.renderer, settings.base_renderer, settings.groups, case.tolerance)
    verifier = Verifier(renderer, target)
    truth = truth_labels(card(NETWORK), case.scene)
    leave = truth if case.label in truth else (case.label,)
    goal = ResolvedGoal(tuple(sorted(target.labels.index(name) for name in leave)), None)
    if bool(goal.fooled(verifier.logits(verifier.image({})))):
        return AttackRow(**known, outcome="wrong to begin with")
    problem = AttackProblem.of(
        renderer,
        target,
        goal,
        Limits.of(
            renderer,
            settings.groups,
            truncation=None if settings.truncation is None else settings.truncation / 255,
        ),
        distance_weight=settings.distance_weight,
        counts=verifier.counts,
    )
    run = run_attack(AttackRun.begin_or_resume(problem, settings, verifier))
    last = run.trace[-1]
    assert run.best is not None
    return AttackRow(
        **known,
        outcome="verified" if run.verified else "fooled in the loop only" if run.fooled else "held",
        steps=run.step,
        queries=last.queries,
        seconds=last.seconds,
        perceptibility=run.trace[run.best.step].perceptibility,
    )


# Work to a verified adversary


@dataclass(frozen=True)
class Success:
    """All attacks of one method on one set of groups within one tolerance; those on scenes that the network got wrong
    were not run, and do not count."""

    attacks: list[AttackRow]

    @property
    def kind(self) -> AttackRow:
        """One of the attacks; renderer, method, groups, tolerance and steps allowed are those of all."""
        return self.attacks[0]

    @property
    def verified(self) -> int:
        """Number of verified attacks."""
        return sum(row.outcome == "verified" for row in self.attacks)

    @property
    def rate(self) -> tuple[float, float]:
        """95 % interval of the rate of verified attacks (Wilson 1927)."""
        return wilson(self.verified, len(self.attacks))

    def median(self, work: Literal["queries", "seconds"]) -> float:
        """The median work of a verified attack; inf if too many of them held.

        It is the lower of the two middle values, so that the infinite work of an attack that held never enters a mean.
        """
        return median_low([getattr(row, work) if row.outcome == "verified" else inf for row in self.attacks])

    @property
    def seconds_per_step(self) -> float:
        """Seconds of all attacks by their steps."""
        return sum(row.seconds for row in self.attacks) / max(1, sum(row.steps for row in self.attacks))


def successes(attacks: Sequence[AttackRow]) -> list[Success]:
    """The attacks by renderer, method, set of groups and tolerance."""
    kinds: dict[tuple[object, ...], list[AttackRow]] = {}
    for row in attacks:
        if row.outcome != "wrong to begin with":
            kinds.setdefault((row.renderer, row.method, row.groups, row.tolerance), []).append(row)
    return [Success(rows) for rows in kinds.values()]
