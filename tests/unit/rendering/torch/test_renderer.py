"""The differentiable renderer against its definition in float64, closed forms, and differences."""

from math import log, pi

import numpy as np
import pytest
import torch
from torch import Tensor

from scene_attack.rendering.plan import Tolerance
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.dsbrdf import ILLUMINATION_MEAN, MATERIAL_UNIT, presets
from scene_attack.rendering.torch.light import illumination
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.scenes.image_file import to_linear
from tests.unit.rendering.shading import GROUND, lambertian, reference_image, sky, sphere_gbuffer, sphere_scene
from tests.unit.rendering.torch.spheres import GROUPS, TIGHT, TWO, moved, sphere

# What an image is


@pytest.mark.parametrize(("tolerance", "rtol"), [("exact", 1e-10), (1e-3, 1e-5)])
@pytest.mark.parametrize("move", [False, True])
def test_image_is_the_sum_it_is_defined_as(tolerance: Tolerance, rtol: float, move: bool) -> None:
    """So few pixels are summed each for itself, in float32 within the tolerance."""
    scene = sphere_scene((7, 9), sky(), TWO)
    gbuffer = sphere_gbuffer(scene, albedo=(0.3, 0.25, 0.2))
    renderer = TorchRenderer(scene, gbuffer, GROUPS, tolerance)
    parameters = moved(renderer) if move else {g: renderer.initial()[g][None] for g in GROUPS}
    found = renderer.render(parameters)[0].double().numpy()
    wanted = reference_image(scene, gbuffer, {g: v[0] for g, v in parameters.items()})
    assert 0.1 < wanted[3, 4].max() < wanted.max() < 0.99  # lit, and nothing clipped
    np.testing.assert_allclose(found, wanted, rtol=rtol)


def test_a_lambertian_sphere_under_white_light_is_flat() -> None:
    """E = πL, so the radiance is albedo · exposure · L, whatever the normal.

    The sum is a midpoint rule: its error is below (π/rows)²/6 and falls with the square of the texel's size.
    """
    albedo, errors = (0.9, 0.5, 0.1), []
    for rows in (8, 16, 32):
        environment = np.ones((rows, 2 * rows, 3), np.float32)
        scene = sphere_scene((24, 24), environment, ("matte",))
        gbuffer = sphere_gbuffer(scene, albedo=albedo)
        image = TorchRenderer(scene, gbuffer, tolerance="exact").render({"material": lambertian()[None, None]})[0]
        unit = illumination(torch.from_numpy(environment)).exposure * ILLUMINATION_MEAN
        whole = gbuffer.coverage == 1
        ratio = torch.from_numpy(to_linear(image.numpy()))[whole] / (unit * gbuffer.base_color[whole].double())
        errors.append(float((ratio - 1).abs().max()))
        assert errors[-1] < (pi / rows) ** 2 / 6
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_one_texel_lights_by_its_cosine() -> None:
    """A Lambertian sphere under one bright texel: I = albedo/π · exposure · ℓ · max(0, n·ω) · ΔΩ."""
    environment = np.zeros((4, 8, 3), np.float32)
    environment[1, 1] = 1
    scene = sphere_scene((24, 24), environment, ("matte",), azimuth=0.3, elevation=0.2)
    gbuffer = sphere_gbuffer(scene, albedo=(0.5, 0.5, 0.5))
    renderer = TorchRenderer(scene, gbuffer, tolerance="exact")
    shown = renderer.render({"material": lambertian()[None, None]})[0]
    image = torch.from_numpy(to_linear(shown.numpy()))
    theta, phi = 1.5 * pi / 4, 1.5 * 2 * pi / 8
    towards = torch.tensor([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)])
    cosine = (gbuffer.normals.double() @ towards).clamp_min(0)
    whole = gbuffer.coverage == 1
    assert (cosine[whole] == 0).any()  # part of it in the dark
    scale = float(image[whole].max() / cosine[whole].max())
    # normals are float32
    torch.testing.assert_close(image[..., 1][whole], scale * cosine[whole], rtol=1e-6, atol=1e-6)


def test_grey_changes_of_coloured_light_are_changes_of_intensity() -> None:
    """To the last bit, images and, summed over the channels, gradients to rounding."""
    renderer = sphere()
    start = renderer.initial()
    change = torch.rand(start["illumination"].shape, generator=torch.Generator().manual_seed(4), dtype=torch.float64)
    one = (start["illumination"] + change)[None].requires_grad_()
    three = change[None, ..., None].repeat(1, 1, 1, 3).requires_grad_()
    images = renderer.render({"illumination": one}), renderer.render({"illumination_rgb": three})
    assert torch.equal(*images)
    assert not torch.equal(images[0], renderer.render({}))
    own, by_channel = (
        torch.autograd.grad(image.square().sum(), leaf)[0] for image, leaf in zip(images, (one, three), strict=True)
    )
    torch.testing.assert_close(by_channel.sum(-1), own, rtol=1e-12, atol=1e-15)


def test_light_of_both_groups_adds_up_and_is_never_negative() -> None:
    renderer = sphere()
    start = renderer.initial()
    lit = start["illumination"].clone()
    off = -2 * start["illumination"][None, ..., None].repeat(1, 1, 1, 3)
    dark = renderer.render({"illumination": lit[None], "illumination_rgb": off})
    black = renderer.render({"illumination": torch.zeros_like(lit)[None]})
    assert torch.equal(dark, black)
    both = renderer.render({"illumination": (lit + 1)[None], "illumination_rgb": torch.ones_like(off)})
    assert torch.equal(both, renderer.render({"illumination": (lit + 2)[None]}))


def test_coverage_lies_over_the_ground() -> None:
    scene = sphere_scene((24, 24), sky(), ("matte",))
    gbuffer = sphere_gbuffer(scene)
    image = TorchRenderer(scene, gbuffer).render({})[0]
    assert (image[gbuffer.coverage == 0] == torch.tensor(GROUND)).all()
    part = (gbuffer.coverage > 0) & (gbuffer.coverage < 1)
    assert part.any()
    whole = TorchRenderer(scene, type(gbuffer)(**vars(gbuffer) | {"coverage": part.float()})).render({})[0]
    share = gbuffer.coverage[part][:, None]
    torch.testing.assert_close(image[part], share * whole[part] + (1 - share) * torch.tensor(GROUND))


def test_nothing_covered_is_ground() -> None:
    scene = sphere_scene((4, 5), sky(), ("matte",))
    gbuffer = sphere_gbuffer(scene)
    empty = type(gbuffer)(**vars(gbuffer) | {"coverage": torch.zeros(4, 5), "object_index": torch.full((4, 5), -1)})
    assert (TorchRenderer(scene, empty).render({}) == torch.tensor(GROUND)).all()


def test_a_material_belongs_to_its_object() -> None:
    renderer = sphere()
    owner = sphere_gbuffer(sphere_scene(materials=TWO)).object_index
    before = renderer.render({})[0]
    material = renderer.initial()["material"]
    material[1] += 5
    changed = (renderer.render({"material": material[None]})[0] != before).any(-1)
    assert (owner[changed] == 1).all()
    assert changed.sum() > 0.9 * (owner == 1).sum()


def test_the_camera_sees_highlights_move_with_it() -> None:
    """Under a map turned with the camera the image stays: shading happens in the camera's frame."""
    environment = sky(16, 32)
    step = 2 * pi / 32
    first = sphere_scene((16, 16), environment, ("glossy-paint",), azimuth=0.0)
    turned = sphere_scene((16, 16), np.roll(environment, 3, axis=1), ("glossy-paint",), azimuth=3 * step)
    one, other = (TorchRenderer(s, sphere_gbuffer(s), tolerance="exact").render({}) for s in (first, turned))
    torch.testing.assert_close(one, other, rtol=0, atol=1e-4)  # the exposure's probes turn with the map, to rounding
    still = sphere_scene((16, 16), np.roll(environment, 3, axis=1), ("glossy-paint",), azimuth=0.0)
    assert (TorchRenderer(still, sphere_gbuffer(still), tolerance="exact").render({}) - one).abs().max() > 0.01


@pytest.mark.parametrize("name", presets())
def test_float32_is_near_its_exact_twin(name: str) -> None:
    """1e-5 of full scale: about a hundred roundings, 1/400 of a step of 8 bits."""
    renderer = sphere((48, 48), TIGHT, sky(16, 32), (name,), albedo=(1, 1, 1))
    twin = renderer.exact()
    assert twin.exact() is twin
    parameters = moved(renderer)
    difference = twin.render({g: v.double() for g, v in parameters.items()}) - renderer.render(parameters).double()
    assert difference.abs().max() < 1e-5
    for group, value in renderer.initial().items():
        assert torch.equal(value.double(), twin.initial()[group])


# Gradients


@pytest.mark.parametrize("group", GROUPS)
def test_gradcheck(group: str) -> None:
    renderer = sphere((4, 5), environment=sky(2, 4))
    start = moved(renderer)
    fixed = {g: v for g, v in start.items() if g != group}
    values = start[group].requires_grad_()
    assert torch.autograd.gradcheck(
        lambda v: renderer.render(fixed | {group: v}), values, fast_mode=values.numel() > 100
    )


def slope(renderer: TorchRenderer, group: str, start: Parameters, weights: Tensor) -> Tensor:
    leaf = start[group].clone().requires_grad_()
    image = renderer.render(start | {group: leaf})
    return torch.autograd.grad((image * weights).sum(), leaf)[0]


@pytest.mark.parametrize("group", GROUPS)
def test_gradient_against_a_central_difference(group: str) -> None:
    renderer = sphere((16, 16), environment=sky(8, 16))
    start = moved(renderer)
    rng = torch.Generator().manual_seed(1)
    weights = torch.randn(1, 16, 16, 3, dtype=torch.float64, generator=rng)
    direction = torch.randn(start[group].shape, dtype=torch.float64, generator=rng)
    h = 1e-5
    up, down = (
        (renderer.render(start | {group: start[group] + sign * h * direction}) * weights).sum() for sign in (1, -1)
    )
    # the difference's own error: h² in its curvature, 1e-16 / h in rounding
    assert float((slope(renderer, group, start, weights) * direction).sum()) == pytest.approx(
        float((up - down) / (2 * h)), rel=1e-6
    )


@pytest.mark.parametrize("group", GROUPS)
def test_float32_gradient_is_near_the_exact_one(group: str) -> None:
    renderer = sphere((16, 16), TIGHT, sky(8, 16))
    start = moved(renderer)
    weights = torch.randn(1, 16, 16, 3, generator=torch.Generator().manual_seed(1))
    exact = slope(renderer.exact(), group, {g: v.double() for g, v in start.items()}, weights.double())
    found = slope(renderer, group, start, weights).double()
    assert (found - exact).norm() < 1e-4 * exact.norm()


def test_uncovered_normals_have_no_effect() -> None:
    renderer = sphere()
    outside = sphere_gbuffer(sphere_scene(materials=TWO)).coverage == 0
    start = moved(renderer)
    assert (renderer.initial()["normals"][outside] == 0).all()
    assert (slope(renderer, "normals", start, torch.ones(1, 12, 12, 3))[0][outside] == 0).all()
    other = start["normals"].clone()
    other[0, outside] += 1
    assert torch.equal(renderer.render(start), renderer.render(start | {"normals": other}))


# Stiff and extreme


@pytest.mark.parametrize("tolerance", [TIGHT, "exact"])
@pytest.mark.parametrize("case", ["mirror", "bright", "dark lobes", "back", "pole", "black map", "far", "sun"])
def test_extremes_stay_finite(tolerance: Tolerance, case: str) -> None:
    environment = sky(8, 16)
    if case == "black map":
        environment[:] = 0
    if case == "sun":
        environment[2, 3] = 1e6
    renderer = sphere((12, 12), tolerance, environment)
    start = {g: renderer.initial()[g][None] for g in GROUPS}
    log_kappa, log_gamma = start["material"][..., 0, :], start["material"][..., 1, :]
    if case == "mirror":
        log_kappa[:], log_gamma[:] = log(1e4) * MATERIAL_UNIT, log(1e5) * MATERIAL_UNIT
    elif case == "bright":
        log_kappa[:], log_gamma[:] = log(1e4) * MATERIAL_UNIT, log(1e-3) * MATERIAL_UNIT
    elif case == "dark lobes":
        log_kappa[:], log_gamma[:] = -1e4, 0
    elif case == "back":
        start["normals"][..., 0] += pi
    elif case == "pole":
        start["normals"][..., 1] = 0
    elif case == "far":
        log_kappa[:], log_gamma[:] = 1e6, 1e6
    leaves = {g: v.clone().requires_grad_() for g, v in start.items()}
    image = renderer.render(leaves)
    assert image.isfinite().all()
    assert ((image >= 0) & (image <= 1)).all()
    for gradient in torch.autograd.grad(image.sum(), list(leaves.values())):
        assert gradient.isfinite().all()


def test_grazing_normals_stay_finite() -> None:
    renderer = sphere(tolerance=TIGHT)
    start = renderer.initial()
    for azimuth in (pi / 2, -pi / 2, pi / 2 + 1e-7, pi / 2 - 1e-7):
        start["normals"][..., 0] = azimuth
        leaf = start["normals"][None].clone().requires_grad_()
        image = renderer.render({"normals": leaf})
        assert image.isfinite().all()
        assert torch.autograd.grad(image.sum(), leaf)[0].isfinite().all()
