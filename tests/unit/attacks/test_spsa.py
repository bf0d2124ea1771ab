import pytest
import torch

from scene_attack.attacks.spsa import SPSA, draw_directions, estimate
from tests.unit.attacks.small import LinearRenderer, autograd, problem, smooth, stepped

pytestmark = pytest.mark.slow

SAMPLES = 4096
KINDS = ["signs", "gaussian"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("batch", [1, 8, 64])
def test_the_estimate_is_unbiased_whatever_its_batch(kind: str, batch: int) -> None:
    """Its mean is autograd's gradient within 4.5 standard errors of 4096 directions, in size and in direction."""
    case = smooth()
    at = 0.01 * torch.arange(9, dtype=torch.float64)
    truth = autograd(case, at)
    half_steps = case.layout.spread({"a": 1e-3, "b": 2e-3})
    estimates = torch.cat(
        [
            estimate(case, at, draw_directions(kind, batch, 9, 7, step), half_steps, gaussian=kind == "gaussian")
            for step in range(SAMPLES // batch)
        ]
    )
    error = estimates.std(dim=0) / SAMPLES**0.5
    assert float(((estimates.mean(dim=0) - truth) / error).abs().max()) < 4.5
    scale = float(estimates.mean(dim=0) @ truth / truth.square().sum())
    assert scale == pytest.approx(1, abs=0.1)
    assert float(error.norm() / truth.norm()) < 0.1  # so a scale of 0.24 or 2 is far beyond the errors


@pytest.mark.parametrize("kind", KINDS)
def test_the_estimate_of_a_direction_does_not_depend_on_the_others(kind: str) -> None:
    case = smooth()
    at, half_steps = torch.zeros(9, dtype=torch.float64), case.layout.spread({"a": 1e-3, "b": 1e-3})
    directions = draw_directions(kind, 64, 9, 1, 0)
    together = estimate(case, at, directions, half_steps, gaussian=kind == "gaussian")
    for k in (0, 31, 63):
        alone = estimate(case, at, directions[k : k + 1], half_steps, gaussian=kind == "gaussian")
        torch.testing.assert_close(alone[0], together[k], rtol=1e-9, atol=1e-9)


def test_signs_are_unbiased_at_a_bound_too() -> None:
    """Group b begins at its lower bound, so one side of its differences is cut off."""
    case = problem(LinearRenderer())
    at, half_steps = torch.zeros(9, dtype=torch.float64), case.layout.spread({"a": 1e-4, "b": 1e-4})
    estimates = estimate(case, at, draw_directions("signs", SAMPLES, 9, 3, 0), half_steps, gaussian=False)
    error = estimates.std(dim=0) / SAMPLES**0.5
    assert float(((estimates.mean(dim=0) - autograd(case, at)) / error).abs().max()) < 4.5


def test_directions_are_signs_or_normal_and_the_seeds() -> None:
    signs, normal = (draw_directions(kind, 2000, 9, 5, 2) for kind in KINDS)
    assert signs.unique().tolist() == [-1.0, 1.0]
    assert float(signs.mean().abs()) < 4.5 / (2000 * 9) ** 0.5
    assert float(normal.var()) == pytest.approx(1, abs=0.05)
    assert torch.equal(signs, draw_directions("signs", 2000, 9, 5, 2))
    assert not torch.equal(signs, draw_directions("signs", 2000, 9, 5, 3))


def settings(**given: object) -> SPSA:
    same = {"a": 0.01, "b": 0.01}
    return SPSA.model_construct(**({"pairs": 5, "directions": "signs", "delta": same, "learning_rate": same} | given))  # type: ignore[arg-type]


def test_a_step_asks_for_two_images_a_direction_and_the_objective_falls() -> None:
    case = smooth()
    state = settings().init(case)
    begin = float(case.goal.advantage(case.target.logits(case.original)))
    for step in range(60):
        queries = case.counts.queries
        state = stepped(case, settings(), state, step)
        assert case.counts.queries - queries == 1 + 10  # the loop's own look, and the step's
    assert float(case.goal.advantage(case.target.logits(case.render(state["delta"][None])))) < 0.5 * begin


def test_adam_moves_as_torch_has_it_on_the_mean_estimate() -> None:
    case = smooth()
    spsa = settings(learning_rate={"a": 0.01, "b": 0.03})
    state = spsa.init(case)
    leaves = [torch.zeros(6, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)]
    adam = torch.optim.Adam(
        [{"params": leaves[:1], "lr": 0.01}, {"params": leaves[1:], "lr": 0.03}], betas=(0.9, 0.999), eps=1e-12
    )
    for step in range(5):
        at = torch.cat(leaves)
        half_steps = case.layout.spread({"a": 0.01, "b": 0.01})
        gradient = estimate(case, at, draw_directions("signs", 5, 9, 0, step), half_steps, gaussian=False).mean(dim=0)
        leaves[0].grad, leaves[1].grad = gradient[:6], gradient[6:]
        adam.step()
        state = stepped(case, spsa, state, step)
        torch.testing.assert_close(state["delta"], torch.cat(leaves), rtol=1e-6, atol=1e-9)
