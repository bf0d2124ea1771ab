"""Dials against a material set by hand, the physics that they state, central differences, and their own limits."""

from itertools import product
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import scene_attack as sa
from scene_attack.process import options
from scene_attack.rendering.torch.dials import bounds, kinds, turned
from scene_attack.rendering.torch.dsbrdf import (
    COSINE_FLOOR,
    LOG_GAMMA_RANGE,
    LOG_KAPPA_RANGE,
    MATERIAL_UNIT,
    basis,
    half_vectors,
    lobes,
    presets,
    reflectance,
)
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve
from tests.unit.rendering import dials as by_hand
from tests.unit.rendering.torch.drill import attacked
from tests.unit.rendering.torch.planned import error, on_sphere
from tests.unit.rendering.torch.spheres import sphere

NAMES = tuple(presets())
GLOSSY = ("plastic", "glossy-paint", "rubber", "brushed-metal", "metal")
WHITE = torch.ones(1, 3)


def material(name: str) -> Tensor:
    """[1, 3, 3, 2, 6]."""
    return presets()[name][None] * MATERIAL_UNIT


def ends(name: str) -> list[list[float]]:
    """All corners of a preset's natural range for a middle grey."""
    low, high = bounds(kinds([name]), 0.5 * WHITE)
    return [list(corner) for corner in product(*zip(low[0].tolist(), high[0].tolist(), strict=True))]


def resolved(**scene: Any) -> ResolvedScene:
    used = options()
    return resolve(
        sa.Scene.model_validate({"camera": {"size": (40, 40)}} | scene), Library(used.cache_dir, used.data_dir)
    )


# Against the definition


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dials", [(0.7, -0.4, 0.3, -0.8, 1.0), (-1.0, 1.0, -1.0, 0.0, 0.5)])
def test_turned_coefficients_are_those_of_the_definition(name: str, dials: tuple[float, ...]) -> None:
    found = turned(material(name), torch.tensor([dials], dtype=torch.float64), kinds([name]))[0]
    wanted = by_hand.turned(name, material(name)[0].numpy(), np.array(dials))
    np.testing.assert_allclose(found.numpy(), wanted, atol=1e-6)  # of 30 a logarithm: Gauss's rule has 64 nodes


def test_dials_draw_the_image_of_the_material_set_by_hand() -> None:
    dials = torch.tensor([[0.5, -0.6, 1.0, -1.0, 0.2], [-0.8, -0.3, 0.4, 0.1, -0.9]], dtype=torch.float64)
    renderer = sphere(materials=("plastic", "brushed-metal"), tolerance="exact")
    own = renderer.initial()["material"].numpy()
    values = [by_hand.turned(name, own[k], dials[k].numpy()) for k, name in enumerate(("plastic", "brushed-metal"))]
    by_dials, by_material = (
        renderer.render({"dials": dials[None]}),
        renderer.render({"material": torch.from_numpy(np.stack(values))[None]}),
    )
    assert (by_dials - renderer.render({})).abs().max() > 0.05
    torch.testing.assert_close(by_dials, by_material, rtol=0, atol=1e-5)


@pytest.mark.parametrize("tolerance", ["exact", 1e-3])
@pytest.mark.parametrize("name", NAMES)
def test_dials_at_zero_leave_the_same_bits(name: str, tolerance: Any) -> None:
    renderer = on_sphere(("dials",), tolerance, size=24, materials=(name,))
    still = {"dials": renderer.initial()["dials"][None]}
    assert torch.equal(renderer.render(still), renderer.render({}))


# Against the physics that the ranges state


def lobe(name: str, dials: tuple[float, ...], theta_h: Tensor, theta_d: float) -> Tensor:
    """The reflectance [n] of a preset's gloss lobe in green that is strongest before it is turned."""
    own = turned(material(name), torch.tensor([dials], dtype=torch.float64), kinds([name]))[0, 1]
    curves = basis(torch.tensor([theta_d], dtype=torch.float64))
    k = 1 + int(lobes(material(name)[0, 1, 1:] / MATERIAL_UNIT, curves)[0].argmax())
    log_kappa, gamma = lobes(own[k] / MATERIAL_UNIT, curves)
    return reflectance(theta_h.cos().log(), log_kappa, gamma)


@pytest.mark.parametrize("name", GLOSSY)
@pytest.mark.parametrize("theta_d", [0.2, 0.8, 1.3])
def test_a_lobe_is_as_wide_and_as_strong_as_its_dial_says(name: str, theta_d: float) -> None:
    """Width is 1 / √(the curvature of log ρ at its peak), by differences; strength is the height of a lobe as wide."""
    step = 1e-3
    near = torch.tensor([0.0, step], dtype=torch.float64)

    def curvature(roughness: float) -> float:
        at, beside = lobe(name, (roughness, 0, 0, 0, 0), near, theta_d).log()
        return float(at - beside)

    before = curvature(0.0)
    for roughness in (-1.0, 0.5, 1.0):
        wider = (before / curvature(roughness)) ** 0.5
        assert wider == pytest.approx(2**roughness, rel=0.03)  # the polynomials of least squares; 1.4 % is the worst
    strong, own = (lobe(name, (0, gloss, 0, 0, 0), near[:1], theta_d) for gloss in (-0.7, 0.0))
    assert float(strong / own) == pytest.approx(2**-0.7, rel=0.03)


def furnace(of: Tensor, degrees: float, count: int = 200) -> Tensor:
    """The share of light [3, lobes] that a material [3, 3, 2, 6] reflects towards a viewer, in a white furnace."""
    viewer = torch.tensor([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])
    polar = (torch.arange(count, dtype=torch.float64) + 0.5) * torch.pi / 2 / count
    azimuth = (torch.arange(2 * count, dtype=torch.float64) + 0.5) * torch.pi / count
    sine, cosine = polar.sin()[:, None], polar.cos()[:, None].expand(-1, 2 * count)
    towards = torch.stack((sine * azimuth.cos(), sine * azimuth.sin(), cosine), -1)
    half, theta_d = half_vectors(towards.reshape(-1, 3), viewer)
    values = reflectance(half[:, 2].clamp_min(COSINE_FLOOR).log(), *lobes(of / MATERIAL_UNIT, basis(theta_d)))
    return (values * (sine * cosine).flatten()).mean(-1) * torch.pi**2


@pytest.mark.parametrize("name", GLOSSY)
def test_a_rougher_surface_reflects_as_much_light_and_gloss_scales_it(name: str) -> None:
    of_lobes = kinds([name])
    glossy = of_lobes[0, 1].bool()

    def gloss(*dials: float, degrees: float) -> float:
        own = turned(material(name), torch.tensor([[*dials, 0, 0, 0]], dtype=torch.float64), of_lobes)[0]
        return float(furnace(own, degrees)[0, glossy].sum())

    for degrees, tolerance in ((0.0, 0.03), (45.0, 0.08)):  # held straight above; 1.7 % and 6.7 % are the worst
        before = gloss(0, 0, degrees=degrees)
        for roughness in (-1.0, 1.0):
            assert gloss(roughness, 0, degrees=degrees) == pytest.approx(before, rel=tolerance)
        assert gloss(0, -1, degrees=degrees) == pytest.approx(before / 2, rel=0.06)


def test_a_tint_is_a_factor_of_the_bodys_channels_alone() -> None:
    of_lobes = kinds(["plastic"])
    before = furnace(material("plastic")[0], 30.0)
    own = turned(material("plastic"), torch.tensor([[0, 0, 1.0, -1.0, 0.5]], dtype=torch.float64), of_lobes)[0]
    factors = (furnace(own, 30.0) / before).numpy()
    np.testing.assert_allclose(factors[:, 0], [1.1, 1 / 1.1, 1.1**0.5], rtol=1e-3)
    np.testing.assert_allclose(factors[:, 1:], 1.0, rtol=1e-12)


# Limits


def test_no_corner_of_the_range_leaves_the_bounds_of_the_material() -> None:
    for name in NAMES:
        corners = torch.tensor(ends(name), dtype=torch.float64)
        found = turned(material(name).expand(len(corners), -1, -1, -1, -1), corners, kinds([name] * len(corners)))
        for values, (low, high) in zip(found.unbind(-2), (LOG_KAPPA_RANGE, LOG_GAMMA_RANGE), strict=True):
            assert values.min() >= low * MATERIAL_UNIT - 1e-9
            assert values.max() <= high * MATERIAL_UNIT + 1e-9


def test_metal_gets_no_glossier_and_white_no_lighter() -> None:
    low, high = bounds(kinds(["plastic", "metal", "matte"]), torch.tensor([[1.0, 0.95, 0.5], [0.5] * 3, [0.0] * 3]))
    assert (low == -1).all()
    assert high[:, :2].tolist() == [[1, 1], [1, 0], [1, 1]]
    np.testing.assert_allclose(
        high[:, 2:].numpy(), [[0, np.log(1 / 0.95) / np.log(1.1), 1], [1] * 3, [1] * 3], rtol=1e-6
    )


def test_a_floor_has_no_dials() -> None:
    scene = resolved(objects=[{"mesh": "primitive/cube", "material": "plastic"}], floor={"size": 6.0})
    renderer = TorchRenderer(scene, groups=("dials",), tolerance="exact")
    assert renderer.initial()["dials"].shape == (1, 5)
    change = renderer.render({"dials": torch.ones(1, 1, 5)}) - renderer.render({})
    of_floor = renderer.bump.shown.pixels[(renderer.bump.shown.object_index == 1) & (renderer.bump.shown.share == 1)]
    assert len(of_floor) > 100
    assert not change.view(-1, 3)[of_floor].any()
    assert change.abs().max() > 0.01


# The plan and the gradient


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("size", [24, 128])
def test_the_plans_error_holds_at_the_ends_of_the_range(name: str, size: int) -> None:
    renderer = on_sphere(("dials",), size=size, materials=(name,))
    corners = ends(name)[::5]
    errors = [error(renderer, {"dials": torch.tensor([[corner]], dtype=torch.float32)}) for corner in corners]
    assert 0 < max(errors) <= renderer.plan.error <= 1e-3
    assert renderer.failed_checks == 0  # no table is too coarse for the narrowest highlights


@pytest.mark.parametrize(
    ("materials", "start"),
    [
        (("plastic", "glossy-paint"), (0.0,) * 5),
        # A metal's flat lobe has the least γ that there is: at 0, wider and narrower differ in slope by 1e-4.
        (("plastic", "brushed-metal"), (0.6, -0.3, 0.2, -0.7, 0.5)),
        (("rubber", "metal"), (-0.6, -0.8, -0.2, 0.7, -0.5)),
    ],
)
def test_gradient_against_a_central_difference(materials: tuple[str, str], start: tuple[float, ...]) -> None:
    renderer = sphere(materials=materials, tolerance="exact")
    rng = torch.Generator().manual_seed(1)
    weights = torch.randn(1, *renderer.size, 3, dtype=torch.float64, generator=rng)

    def objective(values: Tensor) -> Tensor:
        return (renderer.render({"dials": values}) * weights).sum()

    leaf = torch.tensor(start, dtype=torch.float64).repeat(1, 2, 1).requires_grad_()
    (gradient,) = torch.autograd.grad(objective(leaf), leaf)
    step = 1e-5
    for k in range(leaf.numel()):
        moved = step * torch.eye(leaf.numel(), dtype=torch.float64)[k].view_as(leaf)
        difference = (objective(leaf + moved) - objective(leaf - moved)) / (2 * step)
        assert float(gradient.flatten()[k]) == pytest.approx(difference.item(), rel=1e-5, abs=1e-7)


# Words and requests


def test_a_result_says_its_dials_in_percent() -> None:
    result = attacked("dials")
    [change] = result.record.change.things
    own = result.perturbation["dials"][0].tolist()
    percent = {value.name.rpartition(", ")[2]: value.after for value in change.values}
    assert change.subject == "material of drill"
    assert percent["width of its highlights"] == pytest.approx(100 * (2 ** own[0] - 1))
    assert percent["reflectance in blue"] == pytest.approx(100 * (1.1 ** own[4] - 1))
    assert percent["share of the natural range"] == pytest.approx(100 * max(abs(value) for value in own))
    assert f"{abs(percent['strength of its gloss']):.0f} % {'stronger' if own[1] > 0 else 'weaker'}" in change.sentence
    assert [curve.name for curve in change.curves] == ["red", "green", "blue"]
    assert change.curves[0].before != change.curves[0].after


def test_dials_have_no_u_unless_one_is_asked_for() -> None:
    assert sa.FGSM(renderer="torch", groups=["dials"]).truncation is None
