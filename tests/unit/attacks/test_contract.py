"""Renderers, networks and methods that break their protocol end a job with a reason, and never with a result."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from services.attacks.problem import AttackProblem
from services.attacks.run import Budget, Verifier, run
from services.errors import JobFailure
from services.rendering.protocol import Parameters
from tests.unit.attacks.small import LinearRenderer, LinearTarget, guided, problem

Change = Callable[[Tensor], object]


@dataclass
class BadRenderer(LinearRenderer):
    change: Change = lambda images: images

    def render(self, parameters: Parameters) -> Tensor:  # type: ignore[override]
        return self.change(super().render(parameters))  # type: ignore[return-value]


@dataclass
class BadTarget(LinearTarget):
    change: Change = lambda scores: scores

    def logits(self, images: Tensor) -> Tensor:
        return self.change(super().logits(images))  # type: ignore[return-value]


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
    "nothing": (lambda _: None, "is no tensor for each group"),  # type: ignore[arg-type,return-value]
    "lists": (lambda p: {g: v.tolist() for g, v in p.items()}, "is no tensor for each group"),
    "whole numbers": (lambda p: p | {"a": p["a"].long()}, "group 'a' is of torch.int64"),
    "below its bounds": (lambda p: p | {"b": p["b"] - 0.001}, "left the bounds of group 'b' by up to 0.001"),
    "above its bounds": (lambda p: p | {"b": p["b"] + 3}, "left the bounds of group 'b' by up to 2"),
}


def broken(*_: object) -> object:
    raise KeyError("weights\nof\udc80 mine")


def missing(*_: object) -> object:
    raise MemoryError


RAISED = r"raised KeyError: 'weights\nof\udc80 mine'"
METHODS: dict[str, tuple[dict[str, object], str]] = {
    "start returns nothing": ({"start": lambda _: None}, "start returned a NoneType; a dict of settings is due"),
    "start returns NaN": ({"start": lambda _: {"noise": torch.nan}}, "the method measured are not JSON"),
    "start returns a tensor": ({"start": lambda _: {"noise": torch.ones(1)}}, "the method measured are not JSON"),
    "start raises": ({"start": broken}, f"method 'BadMethod' {RAISED}"),
    "advance returns nothing": ({"advance": lambda *_: None}, "advance returned None; a count from 0 is due"),
    "advance returns words": ({"advance": lambda *_: "0" * 999}, "advance returned '0000"),
    "advance counts below 0": ({"advance": lambda *_: -5}, "advance returned -5"),
    "advance raises": ({"advance": broken}, f"method 'BadMethod' {RAISED}"),
    "state is nothing": ({"state": lambda: None}, "state is no dict of tensors"),
    "state has a number": ({"state": lambda: {"best": 3.0}}, "state is no dict of tensors"),
    "state raises": ({"state": broken}, f"method 'BadMethod' {RAISED}"),
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


@pytest.mark.parametrize("name", METHODS)
def test_methods(name: str) -> None:
    parts, words = METHODS[name]
    case = problem(target=LinearTarget(scale=1e-3))
    method = BadMethod(case, lambda p: p)
    vars(method).update(parts)
    with pytest.raises(JobFailure) as failed:
        run(case, method, Verifier(case.renderer, case.target), Budget(3))
    assert words in str(failed.value)


def test_a_perturbation_at_its_bounds_and_one_rounded_past_them_are_allowed() -> None:
    case = problem(target=LinearTarget(scale=1e-3))
    method = BadMethod(case, lambda p: p | {"b": torch.tensor([0.0, -1e-9, 1 + 1e-7], dtype=torch.float64)})
    assert run(case, method, Verifier(case.renderer, case.target), Budget(2)).stopped == "steps"


def test_an_error_says_whose_it_is_and_memory_stays_memory() -> None:
    case = problem()
    start = {group: value[None] for group, value in case.initial.items()}
    for renderer, target in (
        (BadRenderer(change=broken), LinearTarget()),
        (LinearRenderer(), BadTarget(change=broken)),
    ):
        case.renderer, case.target = renderer, target  # type: ignore[assignment]
        whose = f"renderer 'torch' {RAISED}" if target.__class__ is LinearTarget else f"target 'linear' {RAISED}"
        for call in (
            lambda: case.logits(case.render(start)),
            lambda: Verifier(case.renderer, case.target).logits(Verifier(case.renderer, case.target).image({})),
        ):
            with pytest.raises(JobFailure) as failed:
                call()
            assert whose in str(failed.value)
    case.target = BadTarget(change=missing)  # type: ignore[assignment]
    with pytest.raises(MemoryError):
        case.logits(case.original)


def test_scores_and_images_without_a_graph() -> None:
    for renderer, target, whose in (
        (LinearRenderer(), BadTarget(change=lambda x: x.detach()), "target 'linear' returned scores without a graph"),
        (BadRenderer(change=lambda x: x.detach()), LinearTarget(), "renderer 'torch' returned images without a graph"),
    ):
        case = problem(renderer, target)
        with pytest.raises(JobFailure) as failed:
            guided(case, case.nothing())
        assert whose in str(failed.value)


def test_a_state_whose_tensors_share_memory_is_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It failed in jobs of more than two seconds, the time of the first checkpoint."""
    monkeypatch.setattr("services.attacks.run.EVERY", -1.0)
    case = problem(target=LinearTarget(scale=1e-3))
    method = BadMethod(case, lambda p: p)
    both = torch.arange(4.0).requires_grad_()
    vars(method)["state"] = lambda: {"one": both, "two": both, "part": both[1:]}
    run(case, method, Verifier(case.renderer, case.target), Budget(2), checkpoint_path=tmp_path / "checkpoint")
    assert load_file(tmp_path / "checkpoint")["method.part"].tolist() == [1, 2, 3]
