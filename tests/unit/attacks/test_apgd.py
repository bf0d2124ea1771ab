from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from scene_attack.attacks.apgd import APGD
from scene_attack.attacks.attack import State
from scene_attack.attacks.problem import AttackProblem, evaluate
from tests.unit.attacks.small import FreeRenderer, LinearTarget, Pixels, attack, problem

EPSILON = 3 / 255


def settings(epsilon: dict[str, float], steps: int = 100) -> APGD:
    return APGD.model_construct(epsilon=epsilon, steps=steps)


@pytest.mark.parametrize("loss", ["log-odds", "margin"])
def test_it_reaches_the_optimum_of_a_linear_network_exactly(loss: str) -> None:
    """Under L∞ the least of w·x within ε and [0,1] is at the corner x − ε·sign(w), clipped."""
    renderer, target = Pixels(), LinearTarget(scale=1e-3, classes=2)
    case = problem(renderer, target, loss=loss, epsilon={"image": EPSILON})
    found = attack(case, settings({"image": EPSILON}, 20))
    assert found.best is not None
    rows = target.weights[:, case.goal.leave[0]] - target.weights[:, 1 - case.goal.leave[0]]
    corner = (case.original[0] - EPSILON * rows.reshape(4, 5, 3).sign()).clamp(0, 1)
    torch.testing.assert_close(case.original[0] + found.stored["image"], corner, rtol=0, atol=1e-12)
    scores = target.logits(corner[None])[0]
    least = float(scores[case.goal.leave[0]] - scores[1 - case.goal.leave[0]])
    # the image is float32 k/255 where it is shown to the network
    assert found.trace[found.best.step].advantage == pytest.approx(least, abs=1e-7)


UNIT = {"a": 1.0, "b": 1.0}


def handed(case: AttackProblem, attack: APGD, state: State, step: int, objective: float, gradient: Tensor) -> State:
    """The state after a step whose evaluation has this objective and gradient, whatever the network would say."""
    look = evaluate(case, state["delta"], step)
    return attack.step(case, state, replace(look, objective=objective, gradient=gradient))


def test_its_step_shrinks_until_it_rests_at_the_bottom_of_a_bowl() -> None:
    """Sign steps of a fixed size would stay about as far from the bottom as they are long. ½·Σ c·(δ − bottom)²."""
    random = torch.Generator().manual_seed(0)
    bottom = torch.rand(9, generator=random, dtype=torch.float64) - 0.5
    curvature = 10 ** (2 * torch.rand(9, generator=random, dtype=torch.float64))
    case, apgd, objectives = problem(FreeRenderer(), epsilon=UNIT), settings(UNIT, 100), []
    state = apgd.init(case)
    for step in range(100):
        away = state["delta"] - bottom
        objectives.append(float(0.5 * (curvature * away.square()).sum()))
        state = handed(case, apgd, state, step, objectives[-1], curvature * away)
    assert float(state["step_size"]) <= 2 * 2.0**-7  # of 8 checkpoints, all but the first may find nothing better
    assert float((state["best"] - bottom).abs().max()) < 0.01
    assert float(state["objectives"][1]) == pytest.approx(min(objectives))


def test_the_checkpoints_are_the_papers() -> None:
    """p₁ = 0.22, then periods shorter by 0.03 down to 0.06, of 100 steps: w = 22, 41, 57, 70, 80, 87, 93, 99."""
    bottom = torch.full((9,), 0.3, dtype=torch.float64)
    checkpoints, case, apgd = [], problem(FreeRenderer(), epsilon=UNIT), settings(UNIT, 100)
    state = apgd.init(case)
    for step in range(101):
        size = float(state["step_size"])
        # an objective that never improves: each checkpoint halves
        state = handed(case, apgd, state, step, float(step), state["delta"] - bottom)
        if float(state["step_size"]) < size:
            checkpoints.append(step)
    assert checkpoints == [22, 41, 57, 70, 80, 87, 93, 99]


def papers_points(of: Callable[[Tensor], tuple[float, Tensor]], steps: int) -> list[Tensor]:
    """The points of Algorithm 1 of Croce & Hein (2020), written from the paper, for a maximum within ±1 from 0; `of`
    returns the objective and its gradient. The rises are those of the objectives as they were evaluated, and the first
    checkpoint does not ask whether the maximum has stayed, as in the authors' code.
    """
    shares, period = [0.0, 0.22], 0.22
    while shares[-1] < 1:
        period = max(period - 0.03, 0.06)
        shares.append(shares[-1] + period)
    checkpoints = [round(share * steps) for share in shares]
    shown, values, slopes = [torch.zeros(9).double()], [], []
    step_size, before, halved, best_then = 2.0, torch.zeros(9).double(), True, -torch.inf
    for k in range(steps):
        value, slope = of(shown[k])
        values.append(value)
        slopes.append(slope)
        best = max(range(k + 1), key=lambda i: values[i])
        here, sign = shown[k], slope.sign()
        if k in checkpoints[1:]:
            since = checkpoints[checkpoints.index(k) - 1]
            rises = sum(values[i + 1] > values[i] for i in range(since, k))
            stayed = not halved and best_then == values[best]
            halved, best_then = rises <= 0.75 * (k - since) or stayed, values[best]
            if halved:
                step_size /= 2
                here, sign = shown[best], slopes[best].sign()
        forwards = (here + step_size * sign).clamp(-1, 1)
        share = 0.75 if k else 1.0
        shown.append((here + share * (forwards - here) + (1 - share) * (here - before)).clamp(-1, 1))
        before = here
    return shown


@pytest.mark.parametrize("seed", range(5))
def test_its_points_are_those_of_the_papers_algorithm(seed: int) -> None:
    """On a wavy objective, over 100 steps."""
    random = torch.Generator().manual_seed(seed)
    waves, bottom = (torch.rand(9, generator=random, dtype=torch.float64) for _ in range(2))

    def objective(at: Tensor) -> tuple[float, Tensor]:
        leaf = at.clone().requires_grad_()
        value = ((leaf - bottom).square() + 0.3 * (20 * waves * leaf).sin()).sum()
        return value.item(), torch.autograd.grad(value, leaf)[0]

    def risen(at: Tensor) -> tuple[float, Tensor]:
        value, slope = objective(at)
        return -value, -slope

    case, apgd, points = problem(FreeRenderer(), epsilon=UNIT), settings(UNIT, 100), papers_points(risen, 100)
    state = apgd.init(case)
    for step in range(100):
        torch.testing.assert_close(state["delta"], points[step], rtol=0, atol=1e-12)
        state = handed(case, apgd, state, step, *objective(state["delta"]))
    assert float(state["step_size"]) < 0.1


def test_a_halving_goes_back_to_the_best_point() -> None:
    case, apgd, seen = problem(FreeRenderer(), epsilon=UNIT), settings(UNIT, 10), []
    state = apgd.init(case)  # the first checkpoint is after 2 steps
    for step, objective in enumerate([0.0, 1.0, 2.0]):
        seen.append(state["delta"])
        state = handed(case, apgd, state, step, objective, torch.ones(9, dtype=torch.float64))
    assert float(state["step_size"]) == 1.0
    # from the best point, the start: 3/4 of a step of ε, and a quarter of the way to it from the point before
    wanted = (seen[0] + 0.75 * (-1.0) + 0.25 * (seen[0] - seen[1])).clamp(-1, 1)
    torch.testing.assert_close(state["delta"], wanted)


def authors_loop(
    values: Sequence[float], gradient: Callable[[Tensor], Tensor], start: Tensor, epsilon: float, steps: int
) -> tuple[list[Tensor], list[int]]:
    """Algorithm 1 of Croce & Hein 2020, to minimise, if the objective of point k is values[k]: the points that it
    evaluates, and the steps at which it halves. Both conditions are counted from the whole history.
    """

    def inside(x: Tensor) -> Tensor:
        return start + (x - start).clamp(-epsilon, epsilon)

    checkpoints, period = [0], int(0.22 * steps)
    while checkpoints[-1] < steps:
        checkpoints.append(checkpoints[-1] + period)
        period = max(period - int(0.03 * steps), int(0.06 * steps))
    points, signs, halved = [start], [], []
    size, before = 2 * epsilon, start
    for step in range(steps + 1):
        signs.append(gradient(points[step]).sign())
        x, sign = points[step], signs[step]
        if step in checkpoints[1:]:
            last, seen = checkpoints[checkpoints.index(step) - 1], values[: step + 1]
            falls = sum(seen[i + 1] < seen[i] for i in range(last, step))
            # nothing better since the last checkpoint, and the step was not changed there; the first has none before
            idle = last > 0 and last not in halved and min(seen) == min(seen[: last + 1])
            if falls <= 0.75 * (step - last) or idle:  # the paper has <, the authors' code <=
                least = seen.index(min(seen))
                halved.append(step)
                size, x, sign = size / 2, points[least], signs[least]
        share = 1.0 if step == 0 else 0.75
        z = inside(x - size * sign)
        points.append(inside(x + share * (z - x) + (1 - share) * (x - before)))
        before = x
    return points, halved


@pytest.mark.parametrize("falling", [0.5, 0.75, 0.8, 0.9])
def test_it_takes_the_steps_of_the_authors_loop(falling: float) -> None:
    """Through objectives that fall in this share of the steps, stay equal or rise a little in the others, and rise far
    now and then, after which they fall without being the least. Every checkpoint thus goes either way.
    """
    epsilon, steps = 0.5, 100
    apgd = settings({"a": epsilon, "b": epsilon}, steps)
    case = problem(FreeRenderer(), epsilon=apgd.epsilon)
    outcomes = set()
    for seed in range(12):
        random = torch.Generator().manual_seed(seed)
        drawn = torch.rand(steps + 1, 2, generator=random).tolist()
        changes = [8.0 if far < 0.03 else -0.25 if u < falling else 0.25 * (u > 0.9) for u, far in drawn]
        values = torch.tensor(changes).cumsum(0).tolist()
        waves = torch.randn(9, 9, generator=random, dtype=torch.float64)

        def gradient(x: Tensor, waves: Tensor = waves) -> Tensor:
            return (3 * waves @ x + 1).sin()

        wanted, halved = authors_loop(values, gradient, torch.zeros(9, dtype=torch.float64), epsilon, steps)
        state = apgd.init(case)
        sizes = [float(state["step_size"])]
        for step in range(steps + 1):
            torch.testing.assert_close(state["delta"], wanted[step], rtol=0, atol=1e-12)
            state = handed(case, apgd, state, step, values[step], gradient(state["delta"]))
            sizes.append(float(state["step_size"]))
        assert [step for step in range(steps + 1) if sizes[step + 1] < sizes[step]] == halved
        outcomes |= {step in halved for step in (22, 41, 57, 70, 80, 87, 93, 99)}
    assert outcomes == {True, False}
