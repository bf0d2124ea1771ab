"""Whole attacks, as jobs run them: who is fooled, how visibly, after how many seconds and queries."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.placing import placed
from services.attacks.fgsm import Fgsm
from services.attacks.goal import ResolvedGoal
from services.attacks.loop import Budget, run
from services.attacks.problem import AttackProblem
from services.attacks.spec import ATTACKS, AttackSettings
from services.attacks.state import AttackState
from services.attacks.verifier import Verifier
from services.attacks.zoo import Zoo
from services.rendering.factory import build
from services.rendering.plan import Tolerance
from services.rendering.protocol import Renderer
from services.targets.registry import load

NETWORK = "efficientnet-lite0"
SCENES = (
    ("furniture/soccer-ball", "soccer ball"),
    ("furniture/grand-piano", "grand piano"),
    ("furniture/drill", "power drill"),
    ("furniture/toilets-unit-jay-hardy", "toilet seat"),
)
"""Furniture whose name is a label, chosen before any attack was run."""
SETS = (
    ("image", ("image",)),
    ("torch", ("normals",)),
    ("torch", ("illumination",)),
    ("torch", ("material",)),
    ("torch", ("normals", "illumination", "material")),
)
"""What FGSM attacks."""
ZOO: dict[str, object] = {"learning_rate": 5e-3, "weight": 1e-3}
"""With λ = 0.1 and a rate of 0.002 every scene holds for as long as a report can wait."""

Outcome = Literal["verified", "fooled in the loop only", "held", "wrong to begin with"]


class Attacked(BaseModel):
    """One attack. Where it held, `perceptibility` is that of the last picture."""

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
    most: int = Field(description="steps allowed")
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
    attack: AttackSettings
    tolerance: Tolerance
    seed: int = 0


def cases(scenes: int, steps: int, seeds: int, zoo: dict[str, object]) -> list[Case]:
    """FGSM on every set, within the default tolerance and exact, and ZOO, of the first `scenes`; `zoo` are settings.

    FGSM takes nothing from its seed, so that it has one only.
    """
    found = []
    for scene, label in SCENES[:scenes]:
        for renderer, groups in SETS:
            attack = Fgsm.model_validate({"renderer": renderer, "groups": groups, "steps": steps})
            for tolerance in ("exact",) if renderer == "image" else (1e-3, "exact"):
                found.append(Case(scene, label, attack, tolerance))
        blind = Zoo.model_validate({"method": "zoo", "renderer": "pyrender"} | ZOO | zoo)
        found += [Case(scene, label, blind, 1e-3, seed) for seed in range(seeds)]
    return found


def attack(case: Case) -> Attacked:
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
        "most": settings.steps,
    }
    scene = placed(case.scene, size=target_size(), lights={"environment": {"map": "studio", "size": (16, 32)}})
    renderer: Renderer = build(scene, settings.renderer, settings.base_renderer, settings.groups, case.tolerance)
    verifier = Verifier(renderer, target)
    goal = ResolvedGoal(leave=target.labels.index(case.label), reach=None)
    if bool(goal.fooled(verifier.logits(verifier.picture({})))):
        return Attacked(**known, outcome="wrong to begin with")
    problem = AttackProblem(
        renderer=renderer,
        target=target,
        goal=goal,
        groups=settings.groups,
        seed=case.seed,
        truncation=None if settings.truncation is None else settings.truncation / 255,
        weight=settings.distance_weight,
    )
    method = ATTACKS[settings.method].method(settings, problem)
    found = run(problem, method, verifier, Budget(settings.steps))
    last = found.trace[-1]
    return Attacked(
        **known,
        outcome=_outcome(found),
        steps=found.step,
        queries=last.queries,
        seconds=last.seconds,
        perceptibility=found.trace[found.stored_step].perceptibility,
        advantages=[row.advantage for row in found.trace],
    )


def target_size() -> tuple[int, int]:
    """Height and width of the pictures that are attacked: what the network was trained on."""
    return load(NETWORK).input_size


def _outcome(found: AttackState) -> Outcome:
    if found.verified:
        return "verified"
    return "fooled in the loop only" if found.fooled else "held"


def success(attacks: Sequence[Attacked], along: Literal["queries", "seconds"]) -> Iterator[tuple[float, float]]:
    """Steps of a curve: after so many queries or seconds this share of the attacks was verified. Those that held count
    as held; scenes that were wrong to begin with are not in it."""
    run_at_all = [one for one in attacks if one.outcome != "wrong to begin with"]
    won = sorted(float(getattr(one, along)) for one in run_at_all if one.outcome == "verified")
    for number, at in enumerate(won, 1):
        yield at, number / len(run_at_all)
