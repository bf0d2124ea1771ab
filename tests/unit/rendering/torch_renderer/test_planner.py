"""Plans of the torch renderer: what they leave out costs what they say, and nothing they keep is idle."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.rendering.opengl.gbuffer import GBuffer
from services.rendering.plan import Item, Plan, Tolerance
from services.rendering.protocol import Parameters
from services.rendering.torch_renderer import renderer as torch_renderer
from services.rendering.torch_renderer.planner import compile_plan
from services.rendering.torch_renderer.presets import presets
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.rendering.torch_renderer.shader import Recipe
from services.rendering.torch_renderer.units import ILLUMINATION_MEAN
from services.scenes.resolve import ResolvedScene
from tests.unit.rendering.shading import GROUND, sky, sphere_gbuffer, sphere_scene

GROUPS = ("normals", "illumination", "material")


def made(groups: tuple[str, ...] = GROUPS, tolerance: Tolerance = 1e-3, size: int = 64, **scene: Any) -> TorchRenderer:
    """A sphere under a map of 16 × 32 texels."""
    given = {"materials": ("brushed-metal",), "environment": studio()} | scene
    resolved = sphere_scene((size, size), **given)
    return TorchRenderer(resolved, sphere_gbuffer(resolved), groups, tolerance)


def studio(rows: int = 16, cols: int = 32) -> np.ndarray:
    """Soft light with two bright patches."""
    environment = 0.3 + 0.2 * sky(rows, cols)
    environment[rows // 4 : rows // 4 + 2, 1:4] = 20
    environment[rows // 3, cols // 2] = 8
    return environment.astype(np.float32)


def moved(renderer: TorchRenderer, groups: tuple[str, ...], far: float = 1.0, seed: int = 0) -> Parameters:
    """The scene with something of the attacked groups on top: steps of one size with random signs."""
    random = torch.Generator().manual_seed(seed)
    size = {"normals": 0.1, "illumination": 0.1 * ILLUMINATION_MEAN, "material": 1.0}
    start = renderer.initial()
    parameters = {}
    for group in groups:
        sign = (torch.rand(start[group].shape, generator=random) - 0.5).sign()
        low, high = renderer.bounds()[group]
        parameters[group] = (start[group] + far * size[group] * sign).clamp(low, high)[None]
    return parameters


@torch.no_grad()
def error(renderer: TorchRenderer, parameters: Parameters) -> float:
    wide = {group: value.double() for group, value in parameters.items()}
    return float((renderer.render(parameters).double() - renderer.exact().render(wide)).abs().max())


# Error


@st.composite
def scenes(draw: st.DrawFn) -> tuple[ResolvedScene, GBuffer, tuple[str, ...]]:
    """Maps, materials, normals and sizes at random."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows, cols = draw(st.sampled_from([(1, 1), (2, 3), (4, 8), (8, 16), (16, 32), (24, 48)]))
    environment = np.exp(draw(st.floats(0, 3)) * rng.normal(size=(rows, cols, 3)))
    if draw(st.booleans()):
        environment[rng.integers(rows), rng.integers(cols)] *= 10 ** draw(st.floats(0, 6))
    if draw(st.booleans()):
        environment *= rng.random((rows, cols, 1)) < draw(st.floats(0.05, 1))
    size = draw(st.sampled_from([12, 24, 64, 96, 128]))
    materials = tuple(draw(st.lists(st.sampled_from(sorted(presets())), min_size=1, max_size=2)))
    scene = sphere_scene((size, size), environment.astype(np.float32), materials)
    gbuffer = sphere_gbuffer(scene, albedo=rng.random(3))
    rough = torch.tensor(rng.normal(size=(size, size, 3)) * draw(st.floats(0, 0.3)), dtype=torch.float32)
    normals = torch.nn.functional.normalize(gbuffer.normals + rough, dim=-1) * (gbuffer.coverage > 0)[..., None]
    groups = tuple(g for g in GROUPS if g in draw(st.sets(st.sampled_from(GROUPS), min_size=1)))
    return scene, replace(gbuffer, normals=normals), groups


@given(scenes(), st.floats(0, 1), st.integers(0, 100))
@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
def test_errors_are_within_estimate_and_tolerance(drawn: Any, far: float, seed: int) -> None:
    scene, gbuffer, groups = drawn
    renderer = TorchRenderer(scene, gbuffer, groups, 1e-3)
    start = {group: renderer.initial()[group][None] for group in groups}
    for parameters in (start, moved(renderer, groups, far, seed)):
        assert error(renderer, parameters) <= renderer.plan.error <= 1e-3


def test_a_scene_far_from_the_plans_is_summed_after_all() -> None:
    """A sun that was not there when the table was measured: the check sees it, the tolerance holds."""
    renderer = made(("normals", "illumination"), size=96)
    [shader] = renderer.shaders
    assert shader.recipe.rows is not None
    start = {g: renderer.initial()[g][None] for g in ("normals", "illumination")}
    assert error(renderer, start) <= renderer.plan.error
    assert shader.summed_after_all == 0
    start["illumination"][0, 6, 10] += 300 * ILLUMINATION_MEAN
    assert error(renderer, start) <= 1e-3
    assert shader.summed_after_all == 1
    shader.recipe = replace(shader.recipe, guard=None)
    assert error(renderer, start) > 1e-3  # what the check is there for


def test_lobes_of_a_dark_scene_may_be_lit() -> None:
    """All black at first; an attack on the light turns it on, and every lobe must be there."""
    renderer = made(("normals", "illumination"), size=24, environment=np.zeros((4, 8, 3), np.float32))
    lit = moved(renderer, ("normals", "illumination"))
    assert renderer.render(lit).max() > 0.2
    assert error(renderer, lit) <= renderer.plan.error


def test_exact_takes_no_shortcut() -> None:
    renderer = made(tolerance="exact")
    assert renderer.exact() is renderer
    assert renderer.plan.error == 0
    assert renderer.initial()["material"].dtype == torch.float64
    assert all(
        s.recipe.rows is None and s.recipe.varying.all() and len(s.recipe.active_texels) == 512
        for s in renderer.shaders
    )


@pytest.mark.parametrize("groups", [("normals",), ("illumination",), ("material",), GROUPS[:2], GROUPS[1:], GROUPS])
def test_gradients_are_those_of_the_exact_sum(groups: tuple[str, ...]) -> None:
    """As an attack uses them: weighted by what a network's gradient looks like, smooth over some pixels."""
    renderer = made(groups, size=128)
    assert renderer.shaders[0].recipe.rows is not None
    weights = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    weights = torch.nn.functional.interpolate(weights, (128, 128), mode="bicubic").permute(0, 2, 3, 1)
    gradients = []
    for one, dtype in ((renderer, torch.float32), (renderer.exact(), torch.float64)):
        leaves = {g: v.to(dtype).requires_grad_() for g, v in moved(renderer, groups, 0.1).items()}
        images = one.render(leaves)
        gradients.append(torch.autograd.grad((images * weights.to(dtype)).sum(), list(leaves.values())))
    for group, found, wanted in zip(groups, *gradients, strict=True):
        # Catmull-Rom's gradient is of one order less than its value; normals see it directly, the others through sums
        far = float((found.double() - wanted).norm() / wanted.norm())
        assert far < (0.05 if group == "normals" else 5e-3), group
        # what FGSM uses: the sign, where it is not a matter of rounding
        large = wanted.abs() > 0.05 * wanted.abs().amax()
        assert torch.equal(found.sign()[large].double(), wanted.sign()[large]), group


def test_methods_by_what_is_attacked() -> None:
    kinds = {groups: made(groups, size=96).shaders[0].recipe for groups in (("normals",), ("illumination",), GROUPS)}
    assert kinds["normals",].method == "cached_table"
    assert kinds["illumination",].method == "precomputed_transport"
    assert kinds[GROUPS].method == "summed"
    assert kinds["normals",].gray
    assert not kinds[GROUPS].gray


def test_an_exact_renderer_judges_every_group_whatever_is_attacked() -> None:
    """The judge always renders the whole set of parameters."""
    renderer = made(("normals",), "exact", size=12)
    start = {group: value[None] for group, value in renderer.initial().items()}
    assert torch.equal(renderer.exact().render(start), made(tolerance="exact", size=12).render(start))


def test_a_group_that_is_not_attacked_cannot_be_rendered() -> None:
    renderer = made(("normals",))
    with pytest.raises(ValueError, match="illumination"):
        renderer.render({"illumination": renderer.initial()["illumination"][None] * 2})


def test_plans_are_the_same_every_time() -> None:
    one, other = made(size=48), made(size=48)
    assert one.plan == other.plan
    assert Plan.model_validate_json(one.plan.model_dump_json()) == one.plan
    parameters = moved(one, GROUPS)
    assert torch.equal(one.render(parameters), other.render(parameters))


def test_a_table_filled_in_two_goes_is_the_same_table() -> None:
    """A job that is resumed finds its normals in another order; its images are the same to the bit."""
    straight, detour = made(("normals",), size=96), made(("normals",), size=96)
    assert straight.shaders[0].recipe.method == "cached_table"
    far, farther = moved(straight, ("normals",), 1.0), moved(straight, ("normals",), 4.0)
    detour.render(far)
    assert torch.equal(straight.render(farther), detour.render(farther))


# What is kept, and what is left out


Change = Callable[[Recipe], Recipe]


@pytest.fixture
def changed(monkeypatch: pytest.MonkeyPatch) -> Callable[..., TorchRenderer]:
    """`made` with a change to the recipe that was compiled, in float64 so that nothing hides in rounding."""

    def build(change: Change, groups: tuple[str, ...] = GROUPS, **scene: Any) -> TorchRenderer:
        def compile_changed(*arguments: Any) -> tuple[list[Recipe], Plan]:
            recipes, plan = compile_plan(*arguments)
            if arguments[4] == "exact":
                return recipes, plan
            return [replace(change(recipe), dtype=torch.float64) for recipe in recipes], plan

        monkeypatch.setattr(torch_renderer, "compile_plan", compile_changed)
        return made(groups, **scene)

    return build


def item(renderer: TorchRenderer, what: str) -> Item:
    return next(item for item in renderer.plan.items if item.what == what)


def test_pixels() -> None:
    """The others show the ground, whatever is attacked; each that is kept shows something else."""
    renderer = made(size=24)
    parameters = moved(renderer, GROUPS)
    covered = sphere_gbuffer(sphere_scene((24, 24))).coverage > 0
    assert item(renderer, "pixels").kept == int(covered.sum())
    assert ((renderer.render(parameters)[0] != torch.tensor(GROUND)).any(-1) == covered).all()


HALF_DARK = studio() * (np.arange(16) % 3 > 0)[:, None, None].astype(np.float32)


def test_directions_without_light(changed: Callable[..., TorchRenderer]) -> None:
    groups = ("normals", "material")
    plain = changed(lambda recipe: recipe, groups, size=12, environment=HALF_DARK)
    kept = plain.shaders[0].recipe.active_texels
    assert len(kept) == item(plain, "directions").kept == int((torch.tensor(HALF_DARK).sum(-1) > 0).sum()) < 512
    image = plain.render(moved(plain, groups))
    every = changed(lambda r: replace(r, active_texels=torch.arange(512)), groups, size=12, environment=HALF_DARK)
    assert torch.equal(every.render(moved(plain, groups)), image)
    for one in kept[::7]:
        less = changed(
            lambda r, one=one: replace(r, active_texels=kept[kept != one]), groups, size=12, environment=HALF_DARK
        )
        assert not torch.equal(less.render(moved(plain, groups)), image), int(one)


def test_directions_below_every_horizon() -> None:
    """A flat image of one normal sees half the sky; light from the other half has no gradient."""
    renderer = made(("illumination",), size=12)
    gbuffer = sphere_gbuffer(sphere_scene((12, 12)))
    facing = gbuffer.normals[6, 6] * (gbuffer.coverage > 0)[..., None]
    scene = sphere_scene((12, 12), studio(), ("glossy-paint",))
    renderer = TorchRenderer(scene, replace(gbuffer, normals=facing), ("illumination",))
    assert 200 < item(renderer, "directions").kept < 312
    leaf = renderer.exact().initial()["illumination"][None].requires_grad_()
    gradient = torch.autograd.grad(renderer.exact().render({"illumination": leaf}).sum(), leaf)[0].flatten()
    kept = torch.zeros(512, dtype=torch.bool)
    kept[renderer.shaders[0].recipe.active_texels] = True
    assert (gradient[~kept] == 0).all()
    assert (gradient[kept] != 0).all()


def test_lobes(changed: Callable[..., TorchRenderer]) -> None:
    """Of matte one lobe is a straight line and two reflect nothing: either costs what it says, and no less is kept."""
    groups = ("normals",)
    plain = changed(lambda recipe: recipe, groups, size=24, materials=("matte",))
    recipe = plain.shaders[0].recipe
    assert recipe.varying.sum() == 0 or recipe.straight.sum() == 0  # all channels alike
    parameters = moved(plain, groups)
    image = plain.render(parameters)
    every = torch.ones(3, 3, dtype=torch.bool)
    whole = changed(lambda r: replace(r, varying=every, straight=~every), groups, size=24, materials=("matte",))
    lost = float((whole.render(parameters) - image).abs().max())
    assert 0 < lost <= item(plain, "lobes").error
    bright = recipe.varying | recipe.straight
    none = changed(
        lambda r: replace(r, varying=r.varying & ~bright, straight=~every), groups, size=24, materials=("matte",)
    )
    assert (none.render(parameters) - image).abs().max() > 0.1


@pytest.mark.parametrize("lobe", range(3))
def test_each_kept_lobe_is_seen(changed: Callable[..., TorchRenderer], lobe: int) -> None:
    plain = changed(lambda recipe: recipe, ("normals",), size=24)
    assert plain.shaders[0].recipe.varying.all()

    def without(recipe: Recipe) -> Recipe:
        varying = recipe.varying.clone()
        varying[:, lobe] = False
        return replace(recipe, varying=varying)

    less = changed(without, ("normals",), size=24)
    parameters = moved(plain, ("normals",))
    assert (less.render(parameters) - plain.render(parameters)).abs().max() > 1e-3


def test_straight_lobes_of_small_gamma(changed: Callable[..., TorchRenderer]) -> None:
    """Where normals keep still the line is good for γ = 1e-3; what it costs is below what the plan says it may."""
    groups = ("illumination",)
    plain = changed(lambda recipe: recipe, groups, size=24, materials=("matte",), tolerance=1e-2)
    assert plain.shaders[0].recipe.straight[:, 0].all()
    every = torch.ones(3, 3, dtype=torch.bool)
    whole = changed(
        lambda r: replace(r, varying=every, straight=~every), groups, size=24, materials=("matte",), tolerance=1e-2
    )
    parameters = moved(plain, groups)
    lost = float((whole.render(parameters) - plain.render(parameters)).abs().max())
    assert 0 < lost <= item(plain, "lobes").error <= 1e-2


def test_channels(changed: Callable[..., TorchRenderer]) -> None:
    plain = changed(lambda recipe: recipe, ("normals",), size=24)
    assert item(plain, "channels").kept == 1
    three = changed(lambda r: replace(r, gray=False), ("normals",), size=24)
    parameters = moved(plain, ("normals",))
    torch.testing.assert_close(three.render(parameters), plain.render(parameters), rtol=0, atol=1e-12)


def test_sharp_directions(changed: Callable[..., TorchRenderer]) -> None:
    """Left to the table they would cost more than the tolerance; summed at the pixels they cost nothing."""
    plain = changed(lambda recipe: replace(recipe, guard=None), size=96)
    assert len(plain.shaders[0].recipe.per_pixel_texels) > 0
    start = {g: v[None] for g, v in plain.initial().items()}
    assert error(plain, start) <= plain.plan.error
    blurred = changed(lambda r: replace(r, guard=None, per_pixel_texels=r.per_pixel_texels[:0]), size=96)
    assert error(blurred, start) > 1e-3


def test_mesh_of_the_table(changed: Callable[..., TorchRenderer]) -> None:
    start = {g: v[None] for g, v in made(size=96).initial().items()}
    coarse = changed(lambda r: replace(r, guard=None, rows=(r.rows or 0) // 4 * 2), size=96)
    fine = changed(lambda r: replace(r, guard=None, rows=(r.rows or 0) * 2), size=96)
    assert error(coarse, start) > 2 * error(fine, start)
