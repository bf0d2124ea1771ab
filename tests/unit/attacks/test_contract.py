"""Renderers, networks and methods that break their protocol end a job with a reason, and never with a result."""

from collections.abc import Callable
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from services.attacks.loop import Budget, run
from services.attacks.problem import AttackProblem
from services.attacks.verifier import Verifier
from services.errors import JobFailure
from services.rendering.protocol import Parameters
from tests.unit.attacks.small import LinearRenderer, LinearTarget, problem

Change = Callable[[Tensor], object]


@dataclass
class BadRenderer(LinearRenderer):
    change: Change = lambda images: images

    def render(self, parameters: Parameters) -> Tensor:  # type: ignore[override]
        return self.change(super().render(parameters))  # type: ignore[return-value]


@dataclass
class BadTarget(LinearTarget):
    change: Change = lambda scores: scores

    def logits(self, images: Tensor, question: str | None = None) -> Tensor:
        return self.change(super().logits(images, question))  # type: ignore[return-value]


class BadMethod:
    """Proposes nothing, then what `change` makes of it."""

    needs_gradient = False

    def __init__(self, case: AttackProblem, change: Callable[[Parameters], Parameters]) -> None:
        self.perturbation, self._change = case.nothing(), change

    def start(self, problem: AttackProblem) -> dict[str, object]:
        return {}

    def advance(self, problem: AttackProblem, view: object, step: int) -> int:
        self.perturbation = self._change(self.perturbation)
        return 0

    def state(self) -> dict[str, Tensor]:
        return {}

    def load(self, state: dict[str, Tensor]) -> None:
        raise NotImplementedError


IMAGES: dict[str, tuple[Change, str]] = {
    "one image without its axis": (lambda x: x[0], "returned images as torch.float64 of [4, 5, 3]"),
    "grey": (lambda x: x[..., :1], "of [1, 4, 5, 1]; floating-point [1, 4, 5, 3] is due"),
    "channels first": (lambda x: x.permute(0, 3, 1, 2), "of [1, 3, 4, 5]"),
    "half the rows": (lambda x: x[:, ::2], "of [1, 2, 5, 3]"),
    "bytes": (lambda x: (255 * x).byte(), "torch.uint8"),
    "nothing": (lambda _: None, "NoneType"),
    "too bright": (lambda x: x + 0.9, "not in [0,1]"),
    "below black": (lambda x: x - 0.9, "not in [0,1]"),
    "one NaN": (lambda x: x.masked_fill(torch.arange(3) == 1, torch.nan), "non-finite: the renderer"),
    "infinite": (lambda x: x / 0, "non-finite: the renderer"),
}
SCORES: dict[str, tuple[Change, str]] = {
    "of one image": (lambda x: x[0], "target 'linear' returned scores as torch.float64 of [4]"),
    "too few": (lambda x: x[:, :3], "of [1, 3]; floating-point [1, 4] is due"),
    "more than labels": (lambda x: torch.cat([x, x], dim=1), "of [1, 8]"),
    "whole numbers": (lambda x: x.long(), "torch.int64"),
    "an array": (lambda x: x.detach().numpy(), "ndarray"),
    "NaN": (lambda x: x * torch.nan, "non-finite: the network"),
    "infinite": (lambda x: x + torch.inf, "non-finite: the network"),
}
PERTURBATIONS: dict[str, tuple[Callable[[Parameters], Parameters], str]] = {
    "NaN": (lambda p: p | {"a": p["a"] * torch.nan}, "non-finite: the perturbation of group 'a'"),
    "infinite, where bounds would hide it": (lambda p: p | {"b": p["b"] + torch.inf}, "group 'b'"),
    "of a shape that broadcasts": (lambda p: p | {"b": p["b"][:1]}, "internal: the method's perturbation"),
    "without a group": (lambda p: {"a": p["a"]}, "internal: the method's perturbation"),
}


@pytest.mark.parametrize("name", IMAGES)
def test_images(name: str) -> None:
    change, words = IMAGES[name]
    case, bad = problem(), BadRenderer(change=change)
    start = {group: value[None] for group, value in case.initial.items()}
    case.renderer = bad  # type: ignore[assignment]
    with pytest.raises(JobFailure) as inside:
        case.render(start)
    with pytest.raises(JobFailure) as judged:
        Verifier(bad, case.target).render({})  # type: ignore[arg-type]
    assert words in str(inside.value)
    assert words in str(judged.value)


@pytest.mark.parametrize("name", SCORES)
def test_scores(name: str) -> None:
    change, words = SCORES[name]
    case, bad = problem(), BadTarget(change=change)
    case.target = bad  # type: ignore[assignment]
    with pytest.raises(JobFailure) as inside:
        case.logits(case.original)
    with pytest.raises(JobFailure) as judged:
        Verifier(case.renderer, bad).logits(torch.zeros(4, 5, 3, dtype=torch.uint8))  # type: ignore[arg-type]
    assert words in str(inside.value)
    assert words in str(judged.value)


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_perturbations(name: str) -> None:
    change, words = PERTURBATIONS[name]
    case = problem()
    with pytest.raises(JobFailure) as failed:
        run(case, BadMethod(case, change), Verifier(case.renderer, case.target), Budget(3))
    assert words in str(failed.value)
