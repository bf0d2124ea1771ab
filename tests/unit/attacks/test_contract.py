"""Renderers, networks and methods that break their protocol end a job with a reason, and never with a result."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from scene_attack.attacks.attack import Attack, State
from scene_attack.attacks.problem import AttackProblem, Evaluation
from scene_attack.attacks.run import Verifier
from scene_attack.errors import JobFailure
from scene_attack.rendering.protocol import Parameters
from tests.unit.attacks.small import LinearRenderer, LinearTarget, attack, guided, problem

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


class Bad(Attack):
    """Proposes nothing, then what `change` makes of it."""

    needs_gradient: ClassVar[bool] = False
    method: Literal["bad"] = "bad"
    steps: int = 3
    change: ClassVar[Change] = lambda delta: delta

    def init(self, problem: AttackProblem) -> State:
        return {"delta": problem.nothing}

    def step(self, problem: AttackProblem, state: State, evaluation: Evaluation) -> State:
        return {"delta": type(self).change(state["delta"])}  # type: ignore[dict-item]


def bad(**parts: object) -> Bad:
    """With other parts."""
    return type("Bad", (Bad,), parts).model_construct()  # type: ignore[no-any-return, attr-defined]


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
PERTURBATIONS: dict[str, tuple[Change, str]] = {
    "NaN": (lambda d: d.index_fill(0, torch.tensor([0]), torch.nan), "non-finite: the perturbation of group 'a'"),
    "infinite, where bounds would hide it": (lambda d: d.index_fill(0, torch.tensor([7]), torch.inf), "group 'b'"),
    "of a shape that broadcasts": (lambda d: d[:1], "internal: the attack's perturbation is torch.float64 of [1]"),
    "without a group": (lambda d: d[:6], "floating-point [9] is due"),
    "whole numbers": (lambda d: d.long(), "is torch.int64 of [9]"),
    "below its bounds": (lambda d: d - 0.001, "left the bounds of group 'b' by up to 0.001"),
    "above its bounds": (lambda d: d + 3, "left the bounds of group 'b' by up to 2"),
}


def broken(*_: object) -> object:
    raise KeyError("weights\nof\udc80 mine")


def missing(*_: object) -> object:
    raise MemoryError


RAISED = r"raised KeyError: 'weights\nof\udc80 mine'"
METHODS: dict[str, tuple[dict[str, object], str]] = {
    "measured returns nothing": ({"measured": lambda *_: None}, "`measured` returned a NoneType; a dict is due"),
    "measured returns NaN": ({"measured": lambda *_: {"noise": torch.nan}}, "the attack measured are not JSON"),
    "measured returns a tensor": (
        {"measured": lambda *_: {"noise": torch.ones(1)}},
        "the attack measured are not JSON",
    ),
    "init raises": ({"init": broken}, f"method 'bad' {RAISED}"),
    "init returns nothing": ({"init": lambda *_: None}, "state is no dict of tensors"),
    "init returns a number": ({"init": lambda *_: {"best": 3.0}}, "state is no dict of tensors"),
    "init returns no perturbation": ({"init": lambda *_: {"best": torch.ones(1)}}, "state has no `delta`"),
    "step raises": ({"step": broken}, f"method 'bad' {RAISED}"),
    "step returns nothing": ({"step": lambda *_: None}, "state is no dict of tensors"),
    "step returns lists": ({"step": lambda *_: {"delta": [0.0] * 9}}, "state is no dict of tensors"),
}


@pytest.mark.parametrize("name", IMAGES)
def test_images(name: str) -> None:
    change, words = IMAGES[name]
    case, bad = problem(), BadRenderer(change=change)
    with pytest.raises(JobFailure) as inside:
        replace(case, renderer=bad).render(case.nothing[None])  # type: ignore[arg-type]
    with pytest.raises(JobFailure) as judged:
        Verifier(bad, case.target).render({})  # type: ignore[arg-type]
    assert words in str(inside.value)
    assert words in str(judged.value)


@pytest.mark.parametrize("name", SCORES)
def test_scores(name: str) -> None:
    change, words = SCORES[name]
    case, bad = problem(), BadTarget(change=change)
    with pytest.raises(JobFailure) as inside:
        replace(case, target=bad).scores(case.original)  # type: ignore[arg-type]
    with pytest.raises(JobFailure) as judged:
        Verifier(case.renderer, bad).logits(torch.zeros(4, 5, 3, dtype=torch.uint8))  # type: ignore[arg-type]
    assert words in str(inside.value)
    assert words in str(judged.value)


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_perturbations(name: str) -> None:
    change, words = PERTURBATIONS[name]
    case = problem()
    with pytest.raises(JobFailure) as failed:
        attack(case, bad(change=staticmethod(change)))
    assert words in str(failed.value)


@pytest.mark.parametrize("name", METHODS)
def test_methods(name: str) -> None:
    parts, words = METHODS[name]
    case = problem(target=LinearTarget(scale=1e-3))
    with pytest.raises(JobFailure) as failed:
        attack(case, bad(**parts))
    assert words in str(failed.value)


def test_a_perturbation_at_its_bounds_and_one_rounded_past_them_are_allowed() -> None:
    case = problem(target=LinearTarget(scale=1e-3))
    edge = torch.tensor([0.0] * 7 + [-1e-9, 1 + 1e-7], dtype=torch.float64)
    assert attack(case, bad(change=staticmethod(lambda _: edge))).stopped == "steps"


def test_an_error_says_whose_it_is_and_memory_stays_memory() -> None:
    whole = problem()
    for renderer, target in (
        (BadRenderer(change=broken), LinearTarget()),
        (LinearRenderer(), BadTarget(change=broken)),
    ):
        case = replace(whole, renderer=renderer, target=target)  # type: ignore[arg-type]
        whose = f"renderer 'torch' {RAISED}" if target.__class__ is LinearTarget else f"target 'linear' {RAISED}"
        for call in (
            lambda case: case.scores(case.render(case.nothing[None])),
            lambda case: Verifier.of(case).logits(Verifier.of(case).image({})),
        ):
            with pytest.raises(JobFailure) as failed:
                call(case)
            assert whose in str(failed.value)
    with pytest.raises(MemoryError):
        replace(whole, target=BadTarget(change=missing)).scores(whole.original)  # type: ignore[arg-type]


def test_scores_and_images_without_a_graph() -> None:
    for renderer, target, whose in (
        (LinearRenderer(), BadTarget(change=lambda x: x.detach()), "target 'linear' returned scores without a graph"),
        (BadRenderer(change=lambda x: x.detach()), LinearTarget(), "renderer 'torch' returned images without a graph"),
    ):
        case = problem(renderer, target)
        with pytest.raises(JobFailure) as failed:
            guided(case, case.nothing)
        assert whose in str(failed.value)


def test_a_state_whose_tensors_share_memory_is_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It failed in jobs of more than two seconds, the time of the first checkpoint."""
    monkeypatch.setattr("scene_attack.attacks.run.CHECKPOINT_SECONDS", -1.0)
    case = problem(target=LinearTarget(scale=1e-3))
    both = torch.arange(4.0).requires_grad_()
    state = {"delta": case.nothing, "one": both, "two": both, "part": both[1:]}
    attack(case, bad(init=lambda *_: state, step=lambda *_: state), tmp_path / "checkpoint")
    assert load_file(tmp_path / "checkpoint")["state.part"].tolist() == [1, 2, 3]
