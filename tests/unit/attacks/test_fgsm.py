from dataclasses import replace

import pytest
import torch

from services.attacks.fgsm import Fgsm, FgsmMethod
from services.errors import JobFailure
from tests.unit.attacks.small import FreeRenderer, LinearRenderer, LinearTarget, guided, problem

SETTINGS = Fgsm.model_construct(learning_rate={"a": 0.01, "b": 0.02}, momentum=0.9, weight_decay=0.1)


def test_steps_match_torch_sgd_on_the_signed_gradient() -> None:
    """Momentum and weight decay as torch.optim.SGD has them, fed with sign(∇ log-odds) from an independent graph."""
    case = problem()
    method = FgsmMethod(SETTINGS, case)
    start = case.renderer.initial()
    leaf = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    sgd = torch.optim.SGD([leaf], lr=0.01, momentum=0.9, weight_decay=0.1)
    other = torch.zeros(3, dtype=torch.float64)
    for step in range(4):
        view = guided(case, method.perturbation)
        images = case.renderer.render({"a": leaf[None], "b": (start["b"] + other)[None]})
        p = torch.softmax(case.target.logits(images), -1)[0, case.goal.labels[0]]
        (leaf.grad,) = torch.autograd.grad(torch.log(p / (1 - p)), leaf)
        leaf.grad.sign_()
        sgd.step()
        method.advance(case, view, step)
        other = method.perturbation["b"]
        torch.testing.assert_close(method.perturbation["a"], leaf.detach())


def test_groups_step_at_their_own_rate_and_stay_in_bounds() -> None:
    case = problem(FreeRenderer())
    view = guided(case, case.nothing())
    method = FgsmMethod(SETTINGS, case)
    method.advance(case, view, 0)
    assert method.perturbation["a"].tolist() == (-0.01 * view.gradients["a"].sign()).tolist()
    assert method.perturbation["b"].tolist() == (-0.02 * view.gradients["b"].sign()).tolist()
    bounded = problem()  # group b may not go below 0: a downward step is held there
    held = FgsmMethod(SETTINGS, bounded)
    held.advance(bounded, guided(bounded, bounded.nothing()), 0)
    assert held.perturbation["b"].tolist() == method.perturbation["b"].clamp_min(0).tolist()
    assert not torch.equal(held.perturbation["b"], method.perturbation["b"])


def test_a_gradient_that_is_not_a_number_ends_the_job() -> None:
    class Broken(LinearTarget):
        def logits(self, images: torch.Tensor) -> torch.Tensor:
            # finite forward, infinite slope: sqrt at 0
            return super().logits(images) + (images - images.detach()).abs().sum().sqrt()

    case = problem(target=Broken())
    with pytest.raises(JobFailure, match="non-finite: the gradient of group 'a'"):
        guided(case, case.nothing())


def test_a_held_back_pixel_passes_no_gradient() -> None:
    case = problem(LinearRenderer(), truncation=0.01)
    moved = {"a": torch.full((2, 3), 1.0, dtype=torch.float64), "b": torch.zeros(3, dtype=torch.float64)}
    view = case.view(moved, gradient=True)
    held = (case.renderer.render({"a": moved["a"][None]}) - case.original).abs() > 0.01
    assert int(view.truncated.sum()) == int(held.any(-1).sum()) > 0
    (gradient,) = torch.autograd.grad(view.images.sum(), view.perturbation["a"])
    free = (~held).double().flatten()
    torch.testing.assert_close(gradient.flatten(), case.renderer.weights["a"].T @ free)  # type: ignore[attr-defined]
    assert float((view.images.detach() - case.original).abs().max()) <= 0.01 + 1e-12


def test_a_group_whose_gradient_is_zero_is_counted() -> None:
    case = problem()
    view = guided(case, case.nothing())
    assert FgsmMethod(SETTINGS, case).advance(case, view, 0) == 0
    level = replace(view, gradients=view.gradients | {"b": torch.zeros(3, dtype=torch.float64)})
    assert FgsmMethod(SETTINGS, case).advance(case, level, 0) == 1
