"""Fits of parameters to images, on a linear renderer whose derivative is known."""

import pytest
import torch

from scene_attack.analysis.rerendering import fit
from tests.unit.attacks.small import FreeRenderer, LinearRenderer

TRUTH = {"a": torch.full((2, 3), 0.02, dtype=torch.float64), "b": torch.tensor([0.03, 0.0, 0.05], dtype=torch.float64)}


def quiet(done: int) -> None:
    pass


def rendered(renderer: LinearRenderer) -> torch.Tensor:
    return renderer.render({g: v[None] for g, v in TRUTH.items()})[0]


def test_one_step_of_gradient_descent_by_hand() -> None:
    """∂‖I − w‖₁/∂b = Bᵀ sign(I − w), and the first image is that of the scene."""
    renderer = FreeRenderer()
    wanted = rendered(renderer)
    found = fit(renderer, wanted, "sgd", 1e-4, 1, quiet)
    start = renderer.render({g: v[None] for g, v in renderer.initial().items()})[0]
    assert found.losses[0] == pytest.approx(float((start - wanted).abs().mean()), rel=1e-12)
    for group in ("a", "b"):
        gradient = renderer.weights[group].T @ (start - wanted).sign().flatten()
        expected = -1e-4 * gradient.reshape(TRUTH[group].shape)
        assert torch.allclose(found.perturbation[group], expected, atol=1e-15, rtol=1e-9)


@pytest.mark.parametrize(("optimiser", "rate"), [("adam", 1e-3), ("sgd", 1e-4)])
def test_parameters_are_found_again(optimiser: str, rate: float) -> None:
    renderer = FreeRenderer()
    found = fit(renderer, rendered(renderer), optimiser, rate, 300, quiet)  # type: ignore[arg-type]
    assert min(found.losses) < 0.05 * found.losses[0]
    for group, value in TRUTH.items():
        assert torch.allclose(found.perturbation[group], value, atol=5e-3)


def test_only_the_groups_of_the_plan_are_fitted() -> None:
    """A renderer may have groups for which it was not compiled, as coloured light."""
    renderer = FreeRenderer()
    renderer.plan = renderer.plan.model_copy(update={"groups": ("b",)})
    found = fit(renderer, rendered(renderer), "sgd", 1e-4, 3, quiet)
    assert found.perturbation.keys() == {"b"}
    assert found.losses[-1] < found.losses[0]


def test_the_best_step_is_returned_not_the_last() -> None:
    """A rate far too large: the first step already overshoots, and the scene itself stays the best."""
    renderer = FreeRenderer()
    found = fit(renderer, rendered(renderer), "sgd", 1.0, 5, quiet)
    assert found.losses[0] == min(found.losses)
    assert all(bool((value == 0).all()) for value in found.perturbation.values())


def test_an_image_that_no_parameters_make_is_not_explained() -> None:
    """A checkerboard orthogonal to all that the parameters can change: the distance hardly falls."""
    renderer = FreeRenderer()
    basis = torch.cat(list(renderer.weights.values()), dim=1)
    board = torch.tensor([1.0, -1.0], dtype=torch.float64).repeat(30)
    board = board - basis @ torch.linalg.lstsq(basis, board[:, None]).solution[:, 0]
    start = renderer.render({g: v[None] for g, v in renderer.initial().items()})[0]
    found = fit(renderer, start + 0.03 * board.reshape(4, 5, 3), "adam", 1e-3, 100, quiet)
    assert min(found.losses) > 0.9 * found.losses[0]


def test_parameters_stay_within_the_bounds() -> None:
    """b starts at 0, its lower bound, and the wanted image is that of a lower value."""
    renderer = LinearRenderer()
    wanted = FreeRenderer().render(
        {"a": torch.zeros(1, 2, 3, dtype=torch.float64), "b": torch.full((1, 3), -0.1, dtype=torch.float64)}
    )[0]
    found = fit(renderer, wanted, "adam", 1e-2, 20, quiet)
    assert float(found.perturbation["b"].min()) >= 0


def test_every_image_is_counted_before_it_is_rendered() -> None:
    seen: list[int] = []
    fit(FreeRenderer(), rendered(FreeRenderer()), "adam", 1e-3, 4, seen.append)
    assert seen == [0, 1, 2, 3, 4]
