"""The share of a range of views, light and noise for which an adversary holds, measured on fresh variations."""

from collections.abc import Callable, Collection
from math import degrees
from typing import Literal

from scene_attack.analysis.records import HeldOver, SeenFrom
from scene_attack.analysis.verdict import SUCCESS, judge, wilson
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import draw_variation
from scene_attack.attacks.request import Expectation
from scene_attack.attacks.run import Verifier
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.variation import Variation

Answer = Literal["fooled", "held", "wrong"]


def held_over(
    verifier: Verifier,
    goal: ResolvedGoal,
    right: Collection[int],
    perturbation: Parameters,
    asked: Expectation,
    *,
    seed: int,
    tick: Callable[[int, int], None] = lambda *_: None,
) -> HeldOver:
    """Draws `asked.checks` variations that no step of the attack has seen, and renders each by the exact path.

    `right` are the labels that count as right. Of each variation first the clean image is shown to the network; only
    where the answer is right, the attacked image is. `tick` is called before each with its number and their count.
    """
    answers: list[Answer] = []
    views: list[SeenFrom] = []
    for number in range(asked.checks):
        tick(number, asked.checks)
        variation = draw_variation(asked, seed, "fresh", number)
        answers.append(_answer(verifier, goal, right, perturbation, variation))
        if asked.azimuth or asked.elevation:
            around = {"azimuth": degrees(variation.azimuth), "elevation": degrees(variation.elevation)}
            views.append(SeenFrom(**around, answer=answers[-1]))
    wrong, fooled = answers.count("wrong"), answers.count("fooled")
    clean = asked.checks - wrong
    return HeldOver(
        variations=asked.checks,
        right=clean,
        fooled=fooled,
        share=fooled / clean if clean else None,
        interval=wilson(fooled, clean) if clean else None,
        views=views,
        wrong_share=wrong / asked.checks,
        wrong_interval=wilson(wrong, asked.checks),
    )


def _answer(
    verifier: Verifier,
    goal: ResolvedGoal,
    right: Collection[int],
    perturbation: Parameters,
    variation: Variation,
) -> Answer:
    first = int(verifier.logits(verifier.image({}, variation)).argmax())
    if first not in right:
        return "wrong"
    logits = verifier.logits(verifier.image(perturbation, variation))
    return "fooled" if judge(right, first, int(logits.argmax()), bool(goal.fooled(logits))) == SUCCESS else "held"
