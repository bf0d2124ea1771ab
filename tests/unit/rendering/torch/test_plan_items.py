"""The items of a plan: what is left out costs no more than the plan says, and what is kept changes the image."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from scene_attack.rendering.plan import Item, Plan
from scene_attack.rendering.torch import renderer as torch_renderer
from scene_attack.rendering.torch.planner import compile_plan
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.rendering.torch.shader import Recipe
from tests.unit.rendering.shading import GROUND, sphere_gbuffer, sphere_scene
from tests.unit.rendering.torch.planned import GROUPS, error, moved, on_sphere, studio_map

pytestmark = pytest.mark.slow

Change = Callable[[Recipe], Recipe]

HALF_DARK = studio_map() * (np.arange(16) % 3 > 0)[:, None, None].astype(np.float32)


@pytest.fixture
def changed(monkeypatch: pytest.MonkeyPatch) -> Callable[..., TorchRenderer]:
    """`on_sphere` with a change to the compiled recipe, in float64 so that rounding hides no difference."""

    def build(change: Change, groups: tuple[str, ...] = GROUPS, **scene: Any) -> TorchRenderer:
        def compile_changed(*arguments: Any) -> tuple[list[Recipe], Plan]:
            recipes, plan = compile_plan(*arguments)
            if arguments[4] == "exact":
                return recipes, plan
            return [replace(change(recipe), dtype=torch.float64) for recipe in recipes], plan

        monkeypatch.setattr(torch_renderer, "compile_plan", compile_changed)
        return on_sphere(groups, **scene)

    return build


def item(renderer: TorchRenderer, what: str) -> Item:
    return next(item for item in renderer.plan.items if item.what == what)


def test_only_covered_pixels_are_kept() -> None:
    """Pixels without the object show the ground, whatever is attacked. Each pixel that is kept shows something else."""
    renderer = on_sphere(size=24)
    parameters = moved(renderer, GROUPS)
    covered = sphere_gbuffer(sphere_scene((24, 24))).coverage > 0
    assert item(renderer, "pixels").kept == int(covered.sum())
    assert ((renderer.render(parameters)[0] != torch.tensor(GROUND)).any(-1) == covered).all()


def test_directions_without_light_are_left_out(changed: Callable[..., TorchRenderer]) -> None:
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


def test_directions_below_every_horizon_are_left_out() -> None:
    """Where all normals are equal, half of the sky lights the object. Light from the other half has no gradient."""
    renderer = on_sphere(("illumination",), size=12)
    gbuffer = sphere_gbuffer(sphere_scene((12, 12)))
    facing = gbuffer.normals[6, 6] * (gbuffer.coverage > 0)[..., None]
    scene = sphere_scene((12, 12), studio_map(), ("brushed-metal",))
    renderer = TorchRenderer(scene, replace(gbuffer, normals=facing), ("illumination",))
    assert 200 < item(renderer, "directions").kept < 312
    leaf = renderer.exact().initial()["illumination"][None].requires_grad_()
    gradient = torch.autograd.grad(renderer.exact().render({"illumination": leaf}).sum(), leaf)[0].flatten()
    kept = torch.zeros(512, dtype=torch.bool)
    kept[renderer.shaders[0].recipe.active_texels] = True
    assert (gradient[~kept] == 0).all()
    assert (gradient[kept] != 0).all()


def test_lobes_of_small_error_are_left_out_or_made_straight_lines(changed: Callable[..., TorchRenderer]) -> None:
    """One lobe of matte is a straight line, and two reflect nothing. Both shortcuts cost what the plan says, and
    without the rest the image is another."""
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
def test_each_kept_lobe_changes_the_image(changed: Callable[..., TorchRenderer], lobe: int) -> None:
    plain = changed(lambda recipe: recipe, ("normals",), size=24)
    assert plain.shaders[0].recipe.varying.all()

    def without(recipe: Recipe) -> Recipe:
        varying = recipe.varying.clone()
        varying[:, lobe] = False
        return replace(recipe, varying=varying)

    less = changed(without, ("normals",), size=24)
    parameters = moved(plain, ("normals",))
    assert (less.render(parameters) - plain.render(parameters)).abs().max() > 1e-3


def test_lobes_of_small_gamma_are_straight_lines(changed: Callable[..., TorchRenderer]) -> None:
    """Where the normals are not attacked a straight line is good for γ = 1e-3. Its error is below the plan's."""
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


def test_a_gray_scene_needs_one_channel(changed: Callable[..., TorchRenderer]) -> None:
    plain = changed(lambda recipe: recipe, ("normals",), size=24)
    assert item(plain, "channels").kept == 1
    three = changed(lambda r: replace(r, gray=False), ("normals",), size=24)
    parameters = moved(plain, ("normals",))
    torch.testing.assert_close(three.render(parameters), plain.render(parameters), rtol=0, atol=1e-12)


def test_texels_that_the_table_would_blur_are_summed_per_pixel(changed: Callable[..., TorchRenderer]) -> None:
    """In the table their error would be beyond the tolerance. Summed per pixel they have none."""
    plain = changed(lambda recipe: replace(recipe, guard=None), size=96)
    assert len(plain.shaders[0].recipe.per_pixel_texels) > 0
    start = {g: plain.initial()[g][None] for g in GROUPS}
    assert error(plain, start) <= plain.plan.error
    blurred = changed(lambda r: replace(r, guard=None, per_pixel_texels=r.per_pixel_texels[:0]), size=96)
    assert error(blurred, start) > 1e-3


def test_a_finer_table_has_a_smaller_error(changed: Callable[..., TorchRenderer]) -> None:
    initial = on_sphere(size=96).initial()
    start = {g: initial[g][None] for g in GROUPS}
    coarse = changed(lambda r: replace(r, guard=None, rows=(r.rows or 0) // 4 * 2), size=96)
    fine = changed(lambda r: replace(r, guard=None, rows=(r.rows or 0) * 2), size=96)
    assert error(coarse, start) > 2 * error(fine, start)
