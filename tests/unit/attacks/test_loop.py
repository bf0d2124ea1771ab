import math
import zlib
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch

from services.attacks.fgsm import Fgsm, FgsmMethod
from services.attacks.goal import ResolvedGoal
from services.attacks.problem import AttackProblem, Evaluation, quantize
from services.attacks.run import AttackState, Budget, Verifier, run, sampled_error
from services.attacks.zoo import Zoo, ZooMethod
from services.device import finite
from services.errors import Cancelled, JobFailure
from services.rendering.color import as_saved
from services.rendering.plan import ImageError
from tests.unit.attacks.small import Ahead, LinearRenderer, LinearTarget, problem

FGSM = Fgsm.model_construct(learning_rate={"a": 0.01, "b": 0.01}, momentum=0.9, weight_decay=1e-4)
ZOO = Zoo.model_construct(coordinates=4, delta=1e-4, learning_rate=2e-3)


def attack(case: AttackProblem, budget: Budget, *, zoo: bool = False, path: Path | None = None) -> AttackState:
    method = ZooMethod(ZOO, case) if zoo else FgsmMethod(FGSM, case)
    return run(case, method, Verifier(case.renderer, case.target), budget, checkpoint_path=path)


def test_it_stops_when_verified_and_stores_that_step() -> None:
    case = problem()
    found = attack(case, Budget(120))
    assert found.stopped == "verified"
    assert found.fooled
    assert found.verified
    assert found.stored_step == found.step == found.trace[-1].step
    assert [row.advantage < 0 for row in found.trace] == [False] * found.step + [True]
    assert found.trace[0].distance == 0
    assert found.trace[0].perceptibility == 0


def test_the_trace_counts_every_query_and_rendering() -> None:
    case = problem()
    found = attack(case, Budget(120))
    # a look is 1 query and 1 rendering, the original 1 rendering, the verdict 1 of each; the gradient asks nothing more
    assert found.trace[-1].queries == found.step + 1
    assert found.trace[-1].renders == found.step + 2
    assert case.queries == found.trace[-1].queries


@pytest.mark.parametrize("zoo", [False, True])
def test_the_trace_has_what_the_method_minimises(zoo: bool) -> None:
    case = problem(target=LinearTarget(scale=1e-3), weight=0.3)
    for row in attack(case, Budget(3), zoo=zoo).trace:
        assert row.objective is not None
        # the advantage, or the log-odds log p / (1 − p), by definition from the trace's own numbers
        gained = row.advantage if zoo else math.log(row.loss / (1 - row.loss))
        assert row.objective == pytest.approx(gained + 0.3 * row.distance**2, abs=1e-6)


def test_a_pixel_counts_as_truncated_if_it_ever_was() -> None:
    """One step truncates, the next, back at the start, does not; the result counts the pixels of both together."""
    case = problem(target=Ahead(LinearRenderer()), truncation=0.01)

    class ThereAndBack(FgsmMethod):
        def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
            self.perturbation = problem.nothing()
            self.perturbation["a"] += 0.05 if step == 0 else 0.0
            return 0

    found = run(case, ThereAndBack(FGSM, case), Verifier(case.renderer, case.target), Budget(2))
    there = {"a": torch.full((2, 3), 0.05, dtype=torch.float64), "b": torch.zeros(3, dtype=torch.float64)}
    image = case.renderer.render({g: (case.initial[g] + v)[None] for g, v in there.items()})
    beyond = ((image - case.original).abs() > 0.01).any(dim=-1)[0]
    assert [row.truncated for row in found.trace] == [0, int(beyond.sum()), 0]
    assert torch.equal(found.ever, beyond)
    assert int(beyond.sum()) > 0


def test_what_fools_in_the_loop_is_verified_itself_not_what_fooled_more_before() -> None:
    """The first is refused by the verifier. The second fools the loop by less; it is what is verified and stored."""
    case = problem()
    asked: list[Mapping[str, torch.Tensor]] = []
    towards = attack(problem(), Budget(120)).stored

    class SecondOnly(Verifier):
        def fooled(self, perturbation: Mapping[str, torch.Tensor], goal: ResolvedGoal) -> bool:
            asked.append(perturbation)
            return len(asked) == 2

    class Less(FgsmMethod):
        def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
            self.perturbation = problem.clamp({g: (1.5 if step == 0 else 1.0) * v for g, v in towards.items()})
            return 0

    found = run(case, Less(FGSM, case), SecondOnly(case.renderer, case.target), Budget(5))
    assert found.trace[1].advantage < found.trace[2].advantage < 0
    assert (found.stopped, found.stored_step) == ("verified", 2)
    for group, value in towards.items():
        torch.testing.assert_close(asked[1][group], value)
        torch.testing.assert_close(found.stored[group], value)


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
    crossed = [case.goal.fooled(case.logits(case.view(attack(case, Budget(n)).stored).images)) for n in range(10)]
    assert any(crossed)  # float images do, on the way
    found = attack(case, Budget(10))
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
    quick = Fgsm.model_construct(learning_rate={"a": 0.5, "b": 0.5}, momentum=0.0, weight_decay=0.0)
    case = problem(renderer, Shy(classes=2), truncation=0.01)
    found = run(case, FgsmMethod(quick, case), Verifier(case.renderer, case.target), Budget(3))
    assert found.fooled
    assert not found.verified
    assert found.stopped == "steps"
    assert int(found.ever.sum()) > 0


@pytest.mark.parametrize("zoo", [False, True])
def test_budgets_end_it(zoo: bool) -> None:
    hard = LinearTarget(scale=1e-3)
    assert attack(problem(target=hard), Budget(2), zoo=zoo).stopped in ("steps", "verified")
    spent = attack(problem(target=hard, truncation=0.001), Budget(10_000, queries=30), zoo=zoo)
    assert spent.stopped == "queries"
    assert spent.trace[-2].queries < 30 <= spent.trace[-1].queries
    assert attack(problem(target=hard, truncation=0.001), Budget(10_000, seconds=1e-9), zoo=zoo).stopped == "seconds"


@pytest.mark.parametrize("zoo", [False, True])
def test_a_resumed_attack_ends_in_the_same_result(zoo: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("services.attacks.run.EVERY", -1.0)  # after every step
    whole = attack(problem(truncation=0.002), Budget(12), zoo=zoo)
    seen = 0

    def die() -> None:
        nonlocal seen
        seen += 1
        if seen > (8 if zoo else 7):
            raise Cancelled

    with pytest.raises(Cancelled):
        attack(problem(truncation=0.002, interrupt=die), Budget(12), zoo=zoo, path=tmp_path / "checkpoint")
    resumed = attack(problem(truncation=0.002), Budget(12), zoo=zoo, path=tmp_path / "checkpoint")
    for group, value in whole.stored.items():
        assert torch.equal(value, resumed.stored[group])
    assert [row.model_copy(update={"seconds": 0}) for row in whole.trace] == [
        row.model_copy(update={"seconds": 0}) for row in resumed.trace
    ]
    assert torch.equal(whole.ever, resumed.ever)
    assert whole.settings == resumed.settings


class Measured(LinearRenderer):
    """Has an error for each of its images, which depends on nothing else."""

    sampled_error = None  # type: ignore[assignment]

    def render(self, parameters: Mapping[str, torch.Tensor]) -> torch.Tensor:
        images = super().render(parameters)
        for image in images.detach():
            error = zlib.crc32(image.numpy().tobytes(), 2) / 2**32
            self.sampled_error = ImageError(error, error).or_worse(self.sampled_error)  # type: ignore[misc]
        return images


def test_a_resumed_attack_knows_the_errors_of_images_rendered_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.attacks.run.EVERY", -1.0)  # after every step
    path, seen = tmp_path / "checkpoint", 0

    def die() -> None:
        nonlocal seen
        seen += 1
        if seen > 9:
            raise Cancelled

    whole, cut, resumed = (problem(Measured(), truncation=0.002, interrupt=call) for call in (int, die, int))
    wanted = sampled_error(attack(whole, Budget(12)), whole)
    with pytest.raises(Cancelled):
        attack(cut, Budget(12), path=path)
    found = attack(resumed, Budget(12), path=path)
    assert resumed.renderer.sampled_error != wanted  # the worst image was rendered before
    assert sampled_error(found, resumed) == wanted


def test_a_damaged_checkpoint_is_as_good_as_none(tmp_path: Path) -> None:
    (tmp_path / "checkpoint").write_bytes(b"not safetensors at all")
    assert attack(problem(), Budget(12), path=tmp_path / "checkpoint").step == attack(problem(), Budget(12)).step


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
