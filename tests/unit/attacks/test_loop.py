import math
import zlib
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch

from scene_attack.attacks.attack import Attack, State
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import AttackProblem, Evaluation, evaluate, quantize
from scene_attack.attacks.run import AttackRun, Verifier, run_attack
from scene_attack.attacks.zoo import ZOO
from scene_attack.errors import JobFailure
from scene_attack.process import finite
from scene_attack.rendering.color import as_saved
from scene_attack.rendering.plan import ImageError
from tests.unit.attacks.small import Ahead, LinearRenderer, LinearTarget, attack, problem, resumed

BY_SIGN = FGSM.model_construct(learning_rate={"a": 0.01, "b": 0.01}, momentum=0.9, weight_decay=1e-4)
BY_PAIRS = ZOO.model_construct(coordinates=4, delta=1e-4, learning_rate=2e-3)


METHODS = pytest.mark.parametrize("settings", [BY_SIGN, BY_PAIRS], ids=["fgsm", "zoo"])


def test_it_stops_when_verified_and_stores_that_step() -> None:
    case = problem()
    found = attack(case, BY_SIGN)
    assert found.stopped == "verified"
    assert found.fooled
    assert found.verified
    assert found.best is not None
    assert found.best.step == found.step == found.trace[-1].step
    assert [row.advantage < 0 for row in found.trace] == [False] * found.step + [True]
    assert found.trace[0].distance == 0
    assert found.trace[0].perceptibility == 0


def test_the_trace_counts_every_query_and_rendering() -> None:
    case = problem()
    found = attack(case, BY_SIGN)
    # a look is 1 query and 1 rendering, the original 1 rendering, the verdict 1 of each; the gradient asks nothing more
    assert found.trace[-1].queries == found.step + 1
    assert found.trace[-1].renders == found.step + 2
    assert case.counts.queries == found.step + 2  # the verifier's, after the row


@METHODS
def test_the_trace_has_what_the_method_minimises(settings: Attack) -> None:
    case = problem(target=LinearTarget(scale=1e-3), distance_weight=0.3)
    for row in attack(case, settings, steps=3).trace:
        # the advantage, or the log-odds log p / (1 − p), by definition from the trace's own numbers
        gained = row.advantage if settings is BY_PAIRS else math.log(row.loss / (1 - row.loss))
        assert row.objective == pytest.approx(gained + 0.3 * row.distance**2, abs=1e-6)


def test_a_pixel_counts_as_truncated_if_it_ever_was() -> None:
    """One step truncates, the next, back at the start, does not; the result counts the pixels of both together."""
    case = problem(target=Ahead(LinearRenderer()), truncation=0.01)

    there = torch.tensor([0.05] * 6 + [0.0] * 3, dtype=torch.float64)

    class ThereAndBack(FGSM):
        def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
            return state | {"delta": problem.nothing if evaluation.step else there}

    found = attack(case, ThereAndBack.model_construct(**dict(BY_SIGN)), steps=2)
    image = case.renderer.render(case.layout.unflatten((case.initial + there)[None]))
    beyond = ((image - case.original).abs() > 0.01).any(dim=-1)[0]
    assert [row.truncated for row in found.trace] == [0, int(beyond.sum()), 0]
    assert torch.equal(found.ever_truncated, beyond)
    assert int(beyond.sum()) > 0


def test_what_fools_in_the_loop_is_verified_itself_not_what_fooled_more_before() -> None:
    """The first is refused by the verifier. The second fools the loop by less; it is what is verified and stored."""
    case = problem()
    asked: list[Mapping[str, torch.Tensor]] = []
    best = attack(problem(), BY_SIGN).best
    assert best is not None
    towards = best.delta

    class SecondOnly(Verifier):
        def fooled(self, perturbation: Mapping[str, torch.Tensor], goal: ResolvedGoal) -> bool:
            asked.append(perturbation)
            return len(asked) == 2

    class Less(FGSM):
        def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
            return state | {"delta": problem.limits.clamp((1.0 if evaluation.step else 1.5) * towards)}

    settings = Less.model_construct(**dict(BY_SIGN))
    found = run_attack(AttackRun.begin_or_resume(case, settings, SecondOnly.of(case)))
    assert found.trace[1].advantage < found.trace[2].advantage < 0
    assert found.best is not None
    assert (found.stopped, found.best.step) == ("verified", 2)
    torch.testing.assert_close(found.best.delta, towards)
    for group, value in case.layout.unflatten(towards).items():
        torch.testing.assert_close(asked[1][group], value)


def test_success_is_judged_on_the_image_as_saved() -> None:
    """A float image that crosses the boundary by less than rounding gives back must not count."""

    class Edge(LinearTarget):
        """Answers by the sum of sin(2π·255·x): zero on every k/255, so no saved image ever crosses."""

        def logits(self, images: torch.Tensor) -> torch.Tensor:
            off = torch.sin(2 * torch.pi * 255 * images.double()).flatten(1).sum(1)
            return torch.stack([torch.full_like(off, 0.1), off], 1)

    renderer = LinearRenderer()
    renderer.base = (renderer.base * 255).round() / 255
    case = problem(renderer, Edge(classes=2))
    ends = [attack(case, BY_SIGN, steps=n).best for n in range(1, 10)]
    images = [evaluate(case, end.delta, 0).image for end in ends if end is not None]
    assert any(bool(case.goal.fooled(case.scores(image))) for image in images)  # float images do, on the way
    found = attack(case, BY_SIGN, steps=10)
    assert not found.fooled
    assert found.stopped == "steps"


def test_a_image_fooled_by_truncation_alone_does_not_end_the_loop() -> None:
    """Truncation makes image and parameters disagree: the exact re-rendering decides."""

    class Shy(LinearTarget):
        """Another label wins only for images that moved, and moved by no more than U = 0.01."""

        def logits(self, images: torch.Tensor) -> torch.Tensor:
            change = (images.double() - original).abs().flatten(1).amax(1)
            wins = ((change > 0.004) & (change < 0.02)).double()
            slope = images.double().flatten(1).sum(1) * 1e-3
            return torch.stack([1 + slope, 2 * wins], 1)

    renderer = LinearRenderer()
    original = ((renderer.base * 255).round() / 255)[None]
    renderer.base = original[0]
    quick = BY_SIGN.model_construct(learning_rate={"a": 0.5, "b": 0.5}, momentum=0.0, weight_decay=0.0)
    case = problem(renderer, Shy(classes=2), truncation=0.01)
    found = attack(case, quick, steps=3)
    assert found.fooled
    assert not found.verified
    assert found.stopped == "steps"
    assert int(found.ever_truncated.sum()) > 0


@METHODS
def test_budgets_end_it(settings: Attack) -> None:
    hard = LinearTarget(scale=1e-3)
    assert attack(problem(target=hard), settings, steps=2).stopped in ("steps", "verified")
    spent = attack(problem(target=hard, truncation=0.001), settings, steps=10_000, queries=30)
    assert spent.stopped == "queries"
    assert spent.trace[-2].queries < 30 <= spent.trace[-1].queries
    late = attack(problem(target=hard, truncation=0.001), settings, steps=10_000, seconds=1e-9)
    assert late.stopped == "seconds"


@METHODS
def test_a_resumed_attack_ends_in_the_same_result(settings: Attack, tmp_path: Path) -> None:
    resumed(
        lambda: problem(truncation=0.002), settings, tmp_path / "checkpoint", 7 if settings is BY_PAIRS else 6, steps=12
    )


class Measured(LinearRenderer):
    """Has an error for each of its images, which depends on nothing but their 8 bits."""

    sampled_error = None  # type: ignore[assignment]

    def render(self, parameters: Mapping[str, torch.Tensor]) -> torch.Tensor:
        images = super().render(parameters)
        for image in images.detach():
            error = zlib.crc32((255 * image).round().byte().numpy().tobytes(), 2) / 2**32
            self.sampled_error = ImageError(error, error).or_worse(self.sampled_error)  # type: ignore[misc]
        return images


def test_a_resumed_attack_knows_the_errors_of_images_rendered_before(tmp_path: Path) -> None:
    found = resumed(lambda: problem(Measured(), truncation=0.002), BY_SIGN, tmp_path / "checkpoint", 8, steps=12)
    assert found.sampled_error != found.problem.renderer.sampled_error  # the worst image was rendered before


def test_a_damaged_checkpoint_is_as_good_as_none(tmp_path: Path) -> None:
    (tmp_path / "checkpoint").write_bytes(b"not safetensors at all")
    assert attack(problem(), BY_SIGN, tmp_path / "checkpoint").step == attack(problem(), BY_SIGN).step


def test_the_verifier_counts_with_the_problem() -> None:
    case = problem()
    with pytest.raises(ValueError, match="share `counts`"):
        AttackRun.begin_or_resume(case, BY_SIGN, Verifier(case.renderer, case.target))


def test_a_image_of_nan_ends_the_job() -> None:
    renderer = LinearRenderer()
    renderer.base[0, 0, 0] = torch.nan
    with pytest.raises(JobFailure, match="non-finite: the renderer"):
        problem(renderer)


def test_a_saved_image_passes_the_slope_on_as_it_is() -> None:
    images = torch.linspace(0, 1, 60, dtype=torch.float64).reshape(1, 4, 5, 3).requires_grad_()
    weights = torch.randn(1, 4, 5, 3)
    (slope,) = torch.autograd.grad((quantize(images)[1] * weights).sum(), images)
    assert torch.equal(quantize(images)[1], as_saved(images))
    assert torch.equal(slope, weights.double())


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("place", [0, 17, 1023])
def test_one_value_that_is_no_number_is_found(value: float, place: int) -> None:
    values = torch.rand(1024)
    assert finite(values)
    values[place] = value
    assert not finite(values)
