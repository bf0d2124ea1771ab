"""The share of fresh variations for which an adversary holds: of its attack's range of views, light and cameras, or of
cameras alone.
"""

from collections.abc import Callable, Collection
from functools import partial
from math import degrees

from torch import Tensor

from scene_attack.analysis.records import HeldOver, OnVariation, SeenFrom, SurvivalRequest
from scene_attack.analysis.verdict import SUCCESS, judge
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import derived, draw_sensor, draw_variation
from scene_attack.attacks.request import Expectation
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.sensor.photograph import photographed
from scene_attack.rendering.sensor.settings import Sensor

Tick = Callable[[int, int], None]
"""Called before each variation with its number and their count."""


def held_over(
    verifier: Verifier,
    goal: ResolvedGoal,
    right: Collection[int],
    perturbation: Parameters,
    asked: Expectation,
    *,
    seed: int,
    tick: Tick = lambda *_: None,
) -> HeldOver:
    """Draws `asked.checks` variations that no step of the attack has seen, and renders each by the exact path.

    `right` are the labels that count as right. Of each variation first the clean image is shown to the network; only
    where the answer is right, the attacked image is.
    """
    answers: list[OnVariation] = []
    views: list[SeenFrom] = []
    for number in range(asked.checks):
        tick(number, asked.checks)
        variation = draw_variation(asked, seed, "fresh", number)
        clean, attacked = partial(verifier.image, {}, variation), partial(verifier.image, perturbation, variation)
        answers.append(_answer(verifier, goal, right, clean, attacked))
        if asked.azimuth or asked.elevation:
            around = {"azimuth": degrees(variation.azimuth), "elevation": degrees(variation.elevation)}
            views.append(SeenFrom(**around, answer=answers[-1]))
    return HeldOver.of(answers, views)


def survival(
    verifier: Verifier,
    goal: ResolvedGoal,
    right: Collection[int],
    original: Tensor,
    attacked: Tensor,
    asked: SurvivalRequest,
    *,
    seed: int,
    tick: Tick = lambda *_: None,
) -> HeldOver:
    """Has `asked.draws` cameras take both exact images, [H, W, 3] in [0,1] and not rounded, and shows them as
    `held_over` does. Both images of a camera have the same noise.
    """
    answers: list[OnVariation] = []
    for number in range(asked.draws):
        tick(number, asked.draws)
        sensor, noise = draw_sensor(asked, seed, "survival", number), derived(seed, "survival noise", number)

        clean, fooling = partial(_taken, original, sensor, noise), partial(_taken, attacked, sensor, noise)
        answers.append(_answer(verifier, goal, right, clean, fooling))
    return HeldOver.of(answers)


def _taken(image: Tensor, sensor: Sensor, noise: int) -> Tensor:
    """The image [H, W, 3] as a camera takes it, rounded to 8 bits: uint8, on the CPU."""
    return to_bytes(photographed(image[None], sensor, noise)[0]).cpu()


def _answer(
    verifier: Verifier,
    goal: ResolvedGoal,
    right: Collection[int],
    clean: Callable[[], Tensor],
    attacked: Callable[[], Tensor],
) -> OnVariation:
    """The network's answers to the clean and, if that is right, the attacked image, uint8 [H, W, 3], in a word."""
    first = int(verifier.logits(clean()).argmax())
    if first not in right:
        return "wrong"
    logits = verifier.logits(attacked())
    return "fooled" if judge(right, first, int(logits.argmax()), bool(goal.fooled(logits))) == SUCCESS else "held"
