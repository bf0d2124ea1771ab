"""The network's gradient times differences of the image, against autograd through the same renderer.

An estimator may be wrong in scale, in direction, by what else is in its batch, or in what it counts, and attacks still
succeed with it. Each of these is compared with a reference that shares no code with it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from scene_attack.attacks.differences import (
    IMAGE_CANDIDATES,
    PLACES,
    PROBES,
    ImageDifferences,
    measure_image_half_steps,
    projected,
)
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.problem import AttackProblem, Evaluation, differentiate, evaluate
from scene_attack.errors import JobFailure
from scene_attack.rendering.protocol import InactiveCoordinate, Parameters
from tests.unit.attacks.small import CurvedRenderer, LinearTarget, OpaqueCurvedRenderer, attack, problem, resumed

BY_SIGN = FGSM.model_construct(learning_rate={"a": 0.01, "b": 0.01}, momentum=0.9, weight_decay=1e-4)


@dataclass
class CountingTarget(LinearTarget):
    """Counts the images that it classifies, whoever asks."""

    images: int = 0

    def logits(self, images: Tensor) -> Tensor:
        self.images += len(images)
        return super().logits(images)


HALF_STEPS = {"a": 1e-4, "b": 1e-4}


def opaque(seed: int = 0, **settings: object) -> AttackProblem:
    return differenced(problem(OpaqueCurvedRenderer(seed=seed), **settings), HALF_STEPS)


def differenced(case: AttackProblem, half_steps: dict[str, float]) -> AttackProblem:
    return replace(case, differences=ImageDifferences.at(case, half_steps))


def place(seed: int) -> Parameters:
    """A perturbation well within the bounds."""
    random = torch.Generator().manual_seed(100 + seed)
    return {
        "a": 0.2 * torch.randn(2, 3, generator=random, dtype=torch.float64),
        "b": 0.2 + 0.3 * torch.rand(3, generator=random, dtype=torch.float64),
    }


def found(case: AttackProblem, at: Parameters) -> Parameters:
    """The gradient on the float image."""
    gradient = differentiate(case, on_float(case, at)).gradient
    assert gradient is not None
    return case.layout.unflatten(gradient)


def on_float(case: AttackProblem, at: Parameters) -> Evaluation:
    """The evaluation, with the scores of the image that is not rounded."""
    look = evaluate(case, case.layout.flatten(at), 0, gradient=True)
    return replace(look, scores=case.scores(look.image)[0])


def autograd(seed: int, at: Parameters, truncation: float | None = None, weight: float = 0.0) -> Parameters:
    """∂/∂perturbation of log-odds + λ‖ΔY‖² of the truncated image, through the renderer that has gradients."""
    renderer, target = CurvedRenderer(seed=seed), LinearTarget()
    start = renderer.initial()
    with torch.no_grad():
        original = renderer.render({g: v[None] for g, v in start.items()})
        first = int(target.logits(original).argmax())
    leaves = {g: v.clone().requires_grad_() for g, v in at.items()}
    change = renderer.render({g: (start[g] + v)[None] for g, v in leaves.items()}) - original
    if truncation is not None:
        change = change.clamp(-truncation, truncation)
    p = torch.softmax(target.logits(original + change), -1)[0, first]
    (torch.log(p / (1 - p)) + weight * change.square().sum()).backward()
    return {g: v.grad for g, v in leaves.items()}  # type: ignore[misc]


def assert_same(ours: Parameters, true: Parameters, rtol: float = 1e-6) -> None:
    assert ours.keys() == true.keys()
    for group, value in true.items():
        assert float(value.abs().max()) > 1e-2
        torch.testing.assert_close(ours[group], value, rtol=rtol, atol=rtol * float(value.abs().max()))


def test_every_gradient_has_the_scale_and_direction_of_autograd() -> None:
    """Foolbox's estimator is 0.24 times as long as the gradient, and at a batch of 64 its cosine to it is 0.67."""
    for seed in range(64):
        assert_same(found(opaque(seed), place(seed)), autograd(seed, place(seed)))


@pytest.mark.parametrize("weight", [0.0, 0.3])
@pytest.mark.parametrize("truncation", [None, 0.05])
def test_truncated_values_pass_no_gradient_and_the_weight_is_part_of_it(
    truncation: float | None, weight: float
) -> None:
    case, at = opaque(truncation=truncation, distance_weight=weight), place(0)
    assert (int(evaluate(case, case.layout.flatten(at), 0).truncated.sum()) > 3) == (truncation is not None)
    assert_same(found(case, at), autograd(0, at, truncation, weight))


def test_a_difference_at_a_bound_is_divided_by_what_remains_of_it() -> None:
    """Group b starts at its lower bound: one side is clamped there, and the estimate is of first order in δ."""
    case, at = opaque(), place(0)
    at["b"] = torch.zeros(3, dtype=torch.float64)
    ours, true = found(case, at), autograd(0, at)
    assert_same({"a": ours["a"]}, {"a": true["a"]})
    assert_same({"b": ours["b"]}, {"b": true["b"]}, 1e-3)


@pytest.mark.parametrize("chunk", [1, 2, 5, 28])
def test_batches_of_images_of_any_size_give_the_same(chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scene_attack.attacks.problem.MAX_BATCH", chunk)
    case, at = opaque(), place(0)
    sizes, true = [], case.renderer.render

    def render(parameters: Mapping[str, Tensor]) -> Tensor:
        sizes.append(len(parameters["a"]))
        return true(parameters)

    case.renderer.render = render  # type: ignore[method-assign]
    assert_same(found(case, at), autograd(0, at))
    assert max(sizes) <= max(2, chunk)
    assert sum(sizes) == 1 + 2 * 9


def test_a_step_takes_one_query_and_two_images_per_coordinate() -> None:
    """Counted by the network itself; cleverhans' SPSA takes about twice the queries that it is said to take."""
    target = CountingTarget(scale=1e-3)
    case = problem(OpaqueCurvedRenderer(), target)
    before = target.images
    state = attack(case, BY_SIGN, steps=5)
    assert state.stopped == "steps"
    assert target.images - before == state.trace[-1].queries == case.counts.queries
    first, second = state.trace[0], state.trace[1]
    assert second.queries - first.queries == 1
    assert second.renders - first.renders == 1 + 2 * 9
    assert first.queries == 2  # the half-steps are measured with one gradient of the network
    probes = PLACES * (PROBES + 3)  # of group a, which has more, and of all 3 of b
    assert first.renders == 2 + 2 * len(IMAGE_CANDIDATES) * probes


def test_it_fools_as_autograd_does() -> None:
    """The same attack through the renderer with and without gradients takes the same steps."""
    states = []
    for renderer in (CurvedRenderer(), OpaqueCurvedRenderer()):
        case = problem(renderer)
        states.append(attack(case, BY_SIGN, steps=60))
    assert [state.stopped for state in states] == ["verified", "verified"]
    assert states[0].step == states[1].step
    for group, value in states[0].stored.items():
        torch.testing.assert_close(states[1].stored[group], value)


def test_differences_below_the_rounding_of_the_image_are_zero() -> None:
    """A step of 1e-12 moves a float32 image by nothing, or by one rounding: no gradient is made of it."""
    case = problem(OpaqueCurvedRenderer(torch.float32))
    towards = torch.randn(4, 5, 3, generator=torch.Generator().manual_seed(0))
    here, all_of_it = torch.full((9,), 0.1), torch.arange(9)
    tiny = projected(case, here, all_of_it, torch.full((9,), 1e-8, dtype=torch.float64), towards)
    assert (tiny == 0).all()
    seen = projected(case, here, all_of_it, torch.full((9,), 1e-3, dtype=torch.float64), towards)
    assert (seen != 0).all()


def test_half_steps_are_measured_and_recorded() -> None:
    """Too small a step drowns in float32's rounding, too large a one in the curve of the sine."""
    case = problem(OpaqueCurvedRenderer(torch.float32), LinearTarget(dtype=torch.float32))
    chosen = measure_image_half_steps(case)
    assert set(chosen) == {"a", "b"}
    assert all(1e-4 < value < 1e-1 for value in chosen.values())
    assert case.counts.queries == 1
    ours = found(differenced(case, chosen), {g: v.float() for g, v in place(0).items()})
    assert_same({g: v.double() for g, v in ours.items()}, autograd(0, place(0)), 5e-3)
    state = attack(case, BY_SIGN, steps=1)
    assert state.settings == {"image_differences": {"delta": chosen, "skipped": []}}


def test_each_group_has_the_half_step_of_its_own_coordinates() -> None:
    """Group b bends the image forty times as fast as group a, and takes smaller steps for it."""
    renderer = OpaqueCurvedRenderer(torch.float32)
    renderer.weights["b"] *= 40
    chosen = measure_image_half_steps(problem(renderer, LinearTarget(dtype=torch.float32)))
    assert chosen["b"] < chosen["a"]


def test_a_coordinate_that_was_inactive_at_the_start_counts_where_it_is_active() -> None:
    class HiddenAtFirst(OpaqueCurvedRenderer):
        def inactive(self, parameters: Mapping[str, Tensor], reach: Mapping[str, float]) -> Any:
            away = float(parameters["a"].abs().max()) > 0.01
            return () if away else (InactiveCoordinate("b", 1, "b 1", "hidden"),)

    case, at = differenced(problem(HiddenAtFirst()), HALF_STEPS), place(0)
    assert case.differences is not None
    assert case.differences.settings(case)["skipped"] == [{"coordinate": "b 1", "why": "hidden"}]
    start = found(case, {"a": torch.zeros(2, 3).double(), "b": at["b"]})
    assert float(start["b"][1]) == 0 != float(start["b"][0])
    assert_same(found(case, at), autograd(0, at))


def test_a_resumed_attack_ends_in_the_same_result(tmp_path: Path) -> None:
    """It is cancelled at a rendering of the differences, inside the backward pass."""
    hard = LinearTarget(scale=1e-3)
    resumed(
        lambda: problem(OpaqueCurvedRenderer(), hard, truncation=0.01), BY_SIGN, tmp_path / "checkpoint", 14, steps=6
    )


def test_an_image_that_is_not_finite_ends_the_job_from_inside_the_backward_pass() -> None:
    case, at = opaque(), place(0)
    look = on_float(case, at)
    case.renderer.base[0, 0, 0] = torch.nan  # type: ignore[attr-defined]
    with pytest.raises(JobFailure, match="non-finite: the renderer"):
        differentiate(case, look)


def test_a_network_without_gradients_is_named() -> None:
    class Detached(LinearTarget):
        def logits(self, images: Tensor) -> Tensor:
            return super().logits(images).detach()

    case = problem(OpaqueCurvedRenderer(), Detached())
    with pytest.raises(JobFailure, match="target 'linear' returned scores without a graph"):
        attack(case, BY_SIGN, steps=1)
