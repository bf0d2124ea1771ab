"""The natural gradient against closed forms and autograd, and what it gains for the same perceptibility."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from scene_attack.attacks.differences import ImageDifferences
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.natural_gradient import NaturalGradient, steepest
from scene_attack.attacks.problem import AttackProblem
from scene_attack.runs.spec import parse
from tests.unit.attacks.small import (
    CurvedRenderer,
    LinearTarget,
    OpaqueCurvedRenderer,
    attack,
    guided,
    problem,
    resumed,
)

RANDOM = torch.Generator().manual_seed(0)
SETTINGS = NaturalGradient.model_construct(radius=0.005)
HALF_STEPS = {"a": 1e-4, "b": 1e-4}


def metric(total: int = 5) -> Tensor:
    slopes = torch.randn(total, 40, generator=RANDOM, dtype=torch.float64)
    return slopes @ slopes.T / 40


def opaque(*, keeps_metric: bool = True) -> AttackProblem:
    case = problem(OpaqueCurvedRenderer())
    return replace(case, differences=ImageDifferences.at(case, HALF_STEPS, keeps_metric=keeps_metric))


def test_undamped_it_is_the_closed_form_and_no_other_direction_descends_more() -> None:
    m, g = metric(), torch.randn(5, generator=RANDOM, dtype=torch.float64)
    found = steepest(g, m, 0.0)
    inverse = torch.linalg.inv(m)
    torch.testing.assert_close(found, -inverse @ g / (g @ inverse @ g).sqrt())
    assert float(found @ m @ found) == pytest.approx(1.0)
    others = torch.randn(1000, 5, generator=RANDOM, dtype=torch.float64)
    others = others / (others @ m * others).sum(1, keepdim=True).sqrt()
    assert float(g @ found) < float((others @ g).min())


def test_the_units_of_a_coordinate_do_not_matter() -> None:
    """A coordinate in units a thousand times smaller moves a thousand times as far, and the image does the same."""
    m, g = metric(), torch.randn(5, generator=RANDOM, dtype=torch.float64)
    scale = torch.tensor([1.0, 1e3, 1.0, 1e-4, 1.0], dtype=torch.float64)
    other = steepest(g / scale, m / scale[:, None] / scale, 0.3)
    torch.testing.assert_close(other / scale, steepest(g, m, 0.3))


def test_a_coordinate_that_changes_nothing_stays() -> None:
    m, g = metric(), torch.randn(5, generator=RANDOM, dtype=torch.float64)
    m[2] = m[:, 2] = 0.0
    found = steepest(g, m, 0.3)
    kept = [0, 1, 3, 4]
    torch.testing.assert_close(found[kept], steepest(g[kept], m[kept][:, kept], 0.3))
    assert float(found[2]) == 0.0
    assert not steepest(torch.zeros(5, dtype=torch.float64), m, 0.3).any()


def test_the_metric_of_differences_is_that_of_autograd() -> None:
    """dᵀMd = p², with M from the Jacobian of a renderer that has gradients, at a place other than the start."""
    case, renderer = opaque(), CurvedRenderer()
    at = 0.1 * torch.randn(9, generator=RANDOM, dtype=torch.float64).abs()
    found, start = guided(case, at).metric, case.initial + at

    def image(vector: Tensor) -> Tensor:
        return renderer.render({g: value[None] for g, value in case.layout.unflatten(vector).items()}).flatten()

    slopes: Tensor = torch.func.jacrev(image)(start)
    assert found is not None
    torch.testing.assert_close(found, slopes.T @ slopes / 20, rtol=1e-6, atol=1e-8)  # 4×5 pixels
    small = 1e-4 * torch.randn(case.layout.total, generator=RANDOM, dtype=torch.float64)
    p = float((image(start + small) - image(start)).square().sum() / 20) ** 0.5
    assert float(small @ found @ small) ** 0.5 == pytest.approx(p, rel=1e-3)


def test_no_metric_is_kept_for_a_method_that_needs_none() -> None:
    case = opaque(keeps_metric=False)
    assert guided(case, case.nothing).metric is None


def test_the_first_step_changes_the_image_by_the_radius_and_a_failed_one_is_cut() -> None:
    case = opaque()
    look = guided(case, case.start)
    state = SETTINGS.step(case, SETTINGS.init(case), look)
    first = state["delta"]
    change = case.render(first[None]) - case.original
    p = float(change.square().sum(-1).mean().sqrt())
    assert p == pytest.approx(SETTINGS.radius, rel=0.1)  # the image is curved
    worse = replace(guided(case, first, 1), objective=look.objective + 1)
    second = SETTINGS.step(case, state, worse)["delta"]
    assert float(second.norm()) < 0.8 * float(first.norm())  # from the start again, half as far
    assert float(second @ first) > 0


def test_after_a_failed_step_the_metric_counts_less_and_after_a_good_one_more() -> None:
    """The angle to the direction of a huge damping, which ignores how coordinates act together."""
    case = opaque()
    look = guided(case, case.start)
    state = SETTINGS.step(case, SETTINGS.init(case), look)
    assert look.gradient is not None
    assert look.metric is not None
    alone = steepest(look.gradient.double(), look.metric, 1e9)

    def turned(objective: float) -> float:
        after = replace(look, step=1, objective=look.objective + objective)
        step = SETTINGS.step(case, state, after)["delta"] - case.start
        return float(step @ alone / step.norm() / alone.norm())

    failed, first, good = turned(1.0), float(torch.cosine_similarity(state["delta"] - case.start, alone, 0)), turned(-1)
    assert failed - first > 0.01
    assert first - good > 0.005


def test_it_lowers_the_objective_more_than_signs_do_at_the_same_p() -> None:
    """Both are pulled back to the same largest p, with twelve queries each."""
    falls = {}
    hard = LinearTarget(scale=0.3)
    for name in ("natural", "signs"):
        case = problem(OpaqueCurvedRenderer(), hard, perceptibility=0.02)
        signs = FGSM.model_construct(learning_rate={"a": 0.005, "b": 0.005}, momentum=0.9, weight_decay=0.0)
        found = attack(case, SETTINGS if name == "natural" else signs, steps=12)
        assert found.best is not None
        assert found.trace[found.best.step].perceptibility <= 0.02
        falls[name] = found.trace[0].advantage - min(row.advantage for row in found.trace)
    assert falls["natural"] > 1.2 * falls["signs"] > 0


def test_resumed_it_ends_in_the_same_bits(tmp_path: Path) -> None:
    hard = LinearTarget(scale=1e-3)
    resumed(lambda: problem(OpaqueCurvedRenderer(), hard), SETTINGS, tmp_path / "checkpoint", 17, steps=8)


def test_what_it_cannot_do_is_refused_with_what_can() -> None:
    def asked(**more: object) -> dict[str, object]:
        scene = {"objects": [{"mesh": "primitive/sphere"}]}
        return {"scene": scene, "attack": {"method": "natural-gradient", "renderer": "pyrender"} | more}

    assert parse(asked()).attack.radius == 0.01  # type: ignore[attr-defined]
    limited = parse(asked(constraint="backtrack", perceptibility=0.02))
    assert limited.attack.radius == 0.005  # type: ignore[attr-defined]
    with pytest.raises(Exception, match=r"for renderers without gradients \(.*pyrender, sensor.*\); use fgsm"):
        parse(asked(renderer="torch"))
    with pytest.raises(Exception, match="the metric of natural-gradient is that of one image"):
        parse(asked(expectation={"azimuth": 5}))
