import pytest
import torch

from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.problem import evaluate
from scene_attack.errors import JobFailure
from tests.unit.attacks.small import FreeRenderer, LinearRenderer, LinearTarget, attack, guided, problem, stepped

SETTINGS = FGSM.model_construct(learning_rate={"a": 0.01, "b": 0.02}, momentum=0.9, weight_decay=0.1)


def test_steps_match_torch_sgd_on_the_signed_gradient() -> None:
    """Momentum and weight decay as torch.optim.SGD has them, fed with sign(∇ log-odds) from an independent graph."""
    case = problem()
    state = SETTINGS.init(case)
    start = case.renderer.initial()
    leaf = torch.zeros(2, 3, dtype=torch.float64, requires_grad=True)
    sgd = torch.optim.SGD([leaf], lr=0.01, momentum=0.9, weight_decay=0.1)
    other = torch.zeros(3, dtype=torch.float64)
    for step in range(4):
        images = case.renderer.render({"a": leaf[None], "b": (start["b"] + other)[None]})
        p = torch.softmax(case.target.logits(images), -1)[0, case.goal.labels[0]]
        (leaf.grad,) = torch.autograd.grad(torch.log(p / (1 - p)), leaf)
        leaf.grad.sign_()
        sgd.step()
        state = stepped(case, SETTINGS, state, step)
        moved = case.layout.unflatten(state["delta"])
        other = moved["b"]
        torch.testing.assert_close(moved["a"], leaf.detach())


def test_groups_step_at_their_own_rate_and_stay_in_bounds() -> None:
    case = problem(FreeRenderer())
    gradient = guided(case, case.nothing).gradient
    assert gradient is not None
    free = stepped(case, SETTINGS, SETTINGS.init(case), 0)["delta"]
    assert free[:6].tolist() == (-0.01 * gradient[:6].sign()).tolist()
    assert free[6:].tolist() == (-0.02 * gradient[6:].sign()).tolist()
    bounded = problem()  # group b may not go below 0: a downward step is held there
    held = stepped(bounded, SETTINGS, SETTINGS.init(bounded), 0)["delta"]
    assert held[6:].tolist() == free[6:].clamp_min(0).tolist()
    assert not torch.equal(held, free)


def test_a_gradient_that_is_not_a_number_ends_the_job() -> None:
    class Broken(LinearTarget):
        def logits(self, images: torch.Tensor) -> torch.Tensor:
            # finite forward, infinite slope: sqrt at 0
            return super().logits(images) + (images - images.detach()).abs().sum().sqrt()

    case = problem(target=Broken())
    with pytest.raises(JobFailure, match="non-finite: the gradient of group 'a'"):
        guided(case, case.nothing)


def test_a_held_back_pixel_passes_no_gradient() -> None:
    case = problem(LinearRenderer(), truncation=0.01)
    moved = torch.tensor([1.0] * 6 + [0.0] * 3, dtype=torch.float64)
    look = evaluate(case, moved, 0, gradient=True)
    held = (case.renderer.render({"a": moved[:6].reshape(1, 2, 3)}) - case.original).abs() > 0.01
    assert int(look.truncated.sum()) == int(held.any(-1).sum()) > 0
    (gradient,) = torch.autograd.grad(look.image.sum(), look.delta)
    free = (~held).double().flatten()
    torch.testing.assert_close(gradient[:6], case.renderer.weights["a"].T @ free)  # type: ignore[attr-defined]
    assert float((look.image.detach() - case.original).abs().max()) <= 0.01 + 1e-12


def test_a_group_whose_gradient_is_zero_is_counted() -> None:
    case = problem()
    assert attack(case, SETTINGS, steps=1).trace[-1].below_noise == 0
    renderer = LinearRenderer()
    renderer.weights["b"] *= 0
    assert attack(problem(renderer), SETTINGS, steps=1).trace[-1].below_noise == 1
