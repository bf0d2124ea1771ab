from collections.abc import Mapping

import torch

from scene_attack.attacks.differences import CANDIDATES, estimate, measure_half_steps, measure_noise
from scene_attack.attacks.problem import AttackProblem
from tests.unit.attacks.small import FreeRenderer, LinearRenderer, LinearTarget, problem

ALL = torch.arange(9)


def gradient(case: AttackProblem) -> torch.Tensor:
    """Of the objective at the start, by autograd: the reference no difference is involved in."""
    where = case.layout
    flat = torch.zeros(where.total, dtype=torch.float64, requires_grad=True)
    images = case.renderer.render(where.unflatten((case.initial + flat)[None]))
    value = case.goal.advantage(case.target.logits(images))
    value = value + case.distance_weight * (images - case.original).square().sum()
    return torch.autograd.grad(value.sum(), flat)[0]


def test_gradients_agree_with_autograd() -> None:
    case = problem(distance_weight=0.3)
    found = estimate(case, torch.zeros(9).double(), ALL, torch.full((9,), 1e-5).double(), noise=0.0)
    # group b starts on its lower bound: the difference there is one-sided, of first order in δ only
    torch.testing.assert_close(found.gradients[:6], gradient(case)[:6], rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(found.gradients[6:], gradient(case)[6:], rtol=1e-3, atol=1e-5)
    assert not found.below_noise.any()


def test_a_coordinate_does_not_hear_of_the_others_in_its_batch() -> None:
    """The classic bug sums a batch inside the loss; the λ term would then scale with the batch."""
    case = problem(distance_weight=50.0)
    at = 0.05 * torch.ones(9).double()
    deltas = torch.full((9,), 1e-3).double()
    together = estimate(case, at, ALL, deltas, 0.0).gradients
    alone = torch.stack([estimate(case, at, ALL[k : k + 1], deltas[k : k + 1], 0.0).gradients[0] for k in range(9)])
    torch.testing.assert_close(together, alone, rtol=1e-9, atol=1e-10)


def test_eight_bit_images_make_small_differences_flat_and_they_are_called_so() -> None:
    deltas = torch.full((6,), 1e-4).double()
    rounded = estimate(problem(LinearRenderer(eight_bits=True)), torch.zeros(9).double(), ALL[:6], deltas, 1e-9)
    floating = estimate(problem(), torch.zeros(9).double(), ALL[:6], deltas, 1e-9)
    assert not floating.below_noise.any()
    truth = gradient(problem())[:6]
    wrong = (rounded.gradients - truth).abs() / truth.abs()
    assert rounded.below_noise.any() or float(wrong.max()) > 0.5
    assert (rounded.gradients[rounded.below_noise] == 0).all()


def test_noise_is_that_of_the_arithmetic() -> None:
    noise32 = measure_noise(problem(LinearRenderer(torch.float32), LinearTarget(dtype=torch.float32)), torch.zeros(9))
    # float32 sums of 60 products of size 3 cannot be better than 1e-7 nor much worse than 60·3·1.2e-7
    assert 1e-7 < noise32 < 1e-4


def test_the_measured_step_gives_a_slope_near_the_truth() -> None:
    case = problem(LinearRenderer(torch.float32), LinearTarget(dtype=torch.float32))
    noise = measure_noise(case, torch.zeros(9))
    chosen = measure_half_steps(case, torch.full((9,), 0.02), noise)
    assert set(chosen) == {"a", "b"}
    assert all(value in CANDIDATES for value in chosen.values())
    deltas = torch.full((6,), chosen["a"]).double()
    found = estimate(case, torch.zeros(9), ALL[:6], deltas, noise).gradients
    truth = gradient(problem())[:6]
    assert float(torch.nn.functional.cosine_similarity(found, truth, dim=0)) > 0.99


def test_steps_so_large_that_they_cancel_the_weight_are_not_taken() -> None:
    """‖ΔY‖² that saturates, as that of a moving silhouette does: at zero every step looks steady, and 0.1 wins."""

    class Saturating(LinearRenderer):
        def render(self, parameters: Mapping[str, torch.Tensor]) -> torch.Tensor:
            return 0.5 + 0.5 * torch.tanh(100 * (super().render(parameters) - self.base))

    case = problem(Saturating(), distance_weight=1.0)
    reach = torch.full((9,), 0.02).double()
    chosen = measure_half_steps(case, reach, 1e-12)
    assert chosen["a"] <= 3e-3


def test_a_group_that_cannot_change_the_image_gets_the_largest_step_and_is_flat() -> None:
    renderer = LinearRenderer()
    renderer.weights["b"] *= 0
    case = problem(renderer)
    chosen = measure_half_steps(case, torch.full((9,), 0.02).double(), 1e-12)
    assert chosen["b"] == CANDIDATES[0]
    assert estimate(case, torch.zeros(9).double(), ALL[6:], torch.full((3,), 0.1).double(), 1e-12).below_noise.all()


def test_the_layout_is_its_own_inverse() -> None:
    case = problem()
    where = case.layout
    vectors = torch.randn(4, where.total)
    parts = where.unflatten(vectors)
    assert parts["a"].shape == (4, 2, 3)
    torch.testing.assert_close(torch.cat([parts["a"].flatten(1), parts["b"]], 1), vectors)
    assert [where.group_of(k) for k in (0, 5, 6, 8)] == ["a", "a", "b", "b"]


def test_the_objective_is_that_of_the_truncated_image() -> None:
    """As the loop shows it to the network: differences of values that U holds back are zero."""
    limit, weight = 0.01, 0.3
    case = problem(FreeRenderer(), truncation=limit, distance_weight=weight)
    at, deltas = 0.05 * torch.ones(9).double(), torch.full((9,), 2e-2).double()
    found = estimate(case, at, ALL, deltas, noise=0.0).gradients

    def value(flat: torch.Tensor) -> float:
        images = case.renderer.render(case.layout.unflatten((case.initial + flat)[None]))
        change = (images - case.original).clamp(-limit, limit)
        advantage = case.goal.advantage(case.target.logits(case.original + change))
        return float(advantage + weight * change.square().sum())

    sides = torch.eye(9).double() * deltas
    wanted = [(value(at + side) - value(at - side)) / 0.04 for side in sides]
    torch.testing.assert_close(found, torch.tensor(wanted, dtype=torch.float64), rtol=1e-6, atol=1e-9)
