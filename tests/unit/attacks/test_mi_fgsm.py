from dataclasses import replace

import torch

from scene_attack.attacks.mi_fgsm import MIFGSM
from tests.unit.attacks.small import FreeRenderer, LinearTarget, guided, problem, stepped

RATES = {"a": 0.01, "b": 0.02}


def settings(**given: object) -> MIFGSM:
    return MIFGSM.model_construct(**({"learning_rate": RATES, "decay": 0.7} | given))  # type: ignore[arg-type]


def test_steps_match_the_formula_on_gradients_of_an_independent_graph() -> None:
    """Dong et al. 2018, equations 6 and 7, with numpy-like sums over an autograd graph of their own."""
    case = problem(FreeRenderer())
    state, start = settings().init(case), case.renderer.initial()
    delta = {group: torch.zeros_like(value) for group, value in start.items()}
    sums = {group: torch.zeros_like(value) for group, value in start.items()}
    for step in range(5):
        leaves = {group: value.clone().requires_grad_() for group, value in delta.items()}
        images = case.renderer.render({group: (start[group] + leaf)[None] for group, leaf in leaves.items()})
        p = torch.softmax(case.target.logits((images * 255).round() / 255 + images - images.detach()), -1)[0]
        torch.log(p[case.goal.leave[0]] / (1 - p[case.goal.leave[0]])).backward()  # type: ignore[no-untyped-call]
        for group, leaf in leaves.items():
            assert leaf.grad is not None
            sums[group] = 0.7 * sums[group] + leaf.grad / leaf.grad.abs().sum()
            delta[group] = delta[group] - RATES[group] * sums[group].sign()
        state = stepped(case, settings(), state, step)
        for group, value in delta.items():
            torch.testing.assert_close(case.layout.unflatten(state["delta"])[group], value)
            accumulated = case.layout.unflatten(state["accumulated"])[group]
            torch.testing.assert_close(accumulated, sums[group], rtol=1e-4, atol=1e-7)


def test_the_memory_of_a_gradient_is_of_its_direction_not_of_its_size() -> None:
    """Of two gradients, the second larger by 1000: without the norm it alone would decide the sign."""
    case = problem(FreeRenderer())
    state, look = settings().init(case), guided(case, case.nothing)
    first = torch.tensor([3.0, 1.0, 1.0], dtype=torch.float64)
    second = torch.tensor([-1.0, 1.0, -3.0], dtype=torch.float64)
    for gradient in (first, 1000 * second):
        whole = torch.cat([torch.ones(6, dtype=torch.float64), gradient])
        state = settings(decay=1.0).step(case, state, replace(look, gradient=whole))
    assert state["accumulated"][6:].sign().tolist() == [1.0, 1.0, -1.0]


def test_a_group_whose_gradient_is_zero_goes_on_by_its_memory() -> None:
    case = problem(FreeRenderer())
    look = guided(case, case.nothing)
    first = settings().step(case, settings().init(case), look)
    assert look.gradient is not None
    zero = look.gradient.masked_fill(torch.arange(9) > 5, 0.0)
    second = settings().step(case, first, replace(look, gradient=zero))
    assert torch.equal(second["accumulated"][6:], 0.7 * first["accumulated"][6:])


def test_the_loss_decides_the_gradient() -> None:
    """The gradient of the margin is that of two scores; of the log-odds, of all four."""
    target = LinearTarget(scale=0.1)  # far from saturation, where the two are alike
    found = {}
    for name in ("margin", "log-odds"):
        case = problem(FreeRenderer(), target, loss=name)
        gradient = guided(case, case.nothing).gradient
        assert gradient is not None
        found[name] = gradient[:6]
    scores = target.logits(case.original)[0]
    order = scores.argsort(descending=True)
    rows = target.scale * (target.weights[:, order[0]] - target.weights[:, order[1]])
    torch.testing.assert_close(found["margin"], case.renderer.weights["a"].T @ rows)  # type: ignore[attr-defined]
    assert not torch.allclose(found["margin"], found["log-odds"])
