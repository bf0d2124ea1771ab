"""The sampled check: it looks where a table is uneven, and keeps images of attacks within the plan's estimate."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from services.rendering.factory import build
from services.rendering.kernels import compiled
from services.rendering.plan import Plan
from services.rendering.torch_renderer import renderer as renderer_module
from services.rendering.torch_renderer import shader as shader_module
from services.rendering.torch_renderer.planner import compile_plan
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.rendering.torch_renderer.shader import Recipe
from services.rendering.torch_renderer.table import (
    chosen_pixels,
    look_up,
    nearest,
    node_vectors,
    tiles,
    to_vectors,
    touched,
    unevenness,
)
from services.scenes.description import Scene
from services.scenes.library import Library
from services.scenes.resolve import resolve
from services.settings import Settings
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene

pytestmark = pytest.mark.slow

ROWS = 32
EVERY = torch.ones(len(tiles(ROWS)), dtype=torch.bool)


def anywhere(count: int, seed: int = 0) -> Tensor:
    """Angles of several turns, past the poles too."""
    return 20 * torch.rand(count, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 10


def table_of(values: Tensor) -> Tensor:
    """A table of one value a node, in three channels."""
    return values[:, None].expand(-1, 3).contiguous()


def kink(vectors: Tensor) -> Tensor:
    """What a light does where it sets behind the horizon."""
    return (vectors @ torch.tensor([0.3, 0.5, 0.6], dtype=torch.float64)).clamp_min(0.0)


def test_the_nearest_node_is_nearest() -> None:
    """No node's normal is nearer by more than a mesh's diagonal, from anywhere on the sphere."""
    angles = anywhere(500)
    vectors, nodes = to_vectors(angles), node_vectors(ROWS)
    apart = (vectors - nodes[nearest(angles, ROWS)]).norm(dim=1)
    assert float(apart.max()) <= torch.pi / ROWS / 2**0.5 + 1e-9


def test_a_smooth_table_is_even_and_a_kink_is_not_the_pole_included() -> None:
    """Radiance that is smooth over the sphere has small fourth differences at the poles and the seam too."""
    nodes = node_vectors(ROWS)
    smooth = unevenness(table_of(nodes @ torch.tensor([0.3, 0.5, 0.6], dtype=torch.float64)), EVERY)
    bent = unevenness(table_of(kink(nodes)), EVERY)
    mesh = torch.pi / ROWS
    assert float(smooth[0].max()) < 3 * mesh**2
    assert float(smooth[1].max()) < 6 * mesh**4
    assert float(bent[1].max()) > 0.2 * mesh


def test_the_fourth_difference_finds_the_worst_pixel() -> None:
    """It does so nearly: all cells that the kink crosses look alike. A plan allows for a factor of 4."""
    angles = anywhere(3000)
    table = table_of(kink(node_vectors(ROWS)))
    color = torch.ones(3000, 3, dtype=torch.float64)
    shaded = look_up(table, angles)
    errors = (shaded[:, 0] - kink(to_vectors(angles))).abs()
    chosen = chosen_pixels(256, table, touched(angles, ROWS), ROWS, angles, shaded, color)
    assert len(chosen) <= 256
    assert float(errors[chosen].max()) > float(errors.max()) / 2
    assert float(errors[chosen].mean()) > 3 * float(errors.mean())  # what pixels spread evenly would have


def test_the_choice_is_the_image_s_alone() -> None:
    angles = anywhere(3000)
    table = table_of(kink(node_vectors(ROWS)))
    color, shaded = torch.ones(3000, 3, dtype=torch.float64), look_up(table, angles)
    chosen = [
        chosen_pixels(256, table, EVERY, ROWS, angles, shaded * (1 + factor), color) for factor in (0.0, 0.0, 1e-9)
    ]
    assert torch.equal(chosen[0], chosen[1])
    assert not torch.equal(chosen[0], chosen[2])  # others by turns


@pytest.mark.parametrize("few", [True, False])
def test_native_and_torch_choose_the_same_pixels(monkeypatch: pytest.MonkeyPatch, few: bool) -> None:
    """In float64, where no two pixels are equally likely. A table of few filled tiles has holes, one of many the poles
    and the seam."""
    random = torch.Generator().manual_seed(2)
    angles = anywhere(300, seed=3) * (0.03 if few else 1.0)
    table = torch.rand(2 * ROWS**2, 3, generator=random, dtype=torch.float64)
    color = torch.rand(300, 3, generator=random, dtype=torch.float64)
    filled, shaded = touched(angles, ROWS), look_up(table, angles)
    nodes = tiles(ROWS)[filled].flatten()
    assert (len(nodes) < len(table) / 4) == few
    given = (table, filled, ROWS, angles, shaded, color)
    uneven, chosen = unevenness(table, filled)[:, nodes], [chosen_pixels(most, *given) for most in (60, 256, 300)]
    monkeypatch.setattr(compiled, "library", lambda: None)
    torch.testing.assert_close(unevenness(table, filled)[:, nodes], uneven, rtol=0, atol=1e-14)
    for most, indices in zip((60, 256, 300), chosen, strict=True):
        assert torch.equal(chosen_pixels(most, *given), indices)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_choice_does_not_depend_on_the_number_of_threads(dtype: torch.dtype) -> None:
    """Of pixels that look alike it takes the first."""
    angles, table = anywhere(3000).to(dtype), table_of(kink(node_vectors(ROWS))).to(dtype)
    alike = angles[:50].repeat(60, 1)
    color, threads = torch.ones(3000, 3, dtype=dtype), torch.get_num_threads()
    found = []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            found += [chosen_pixels(256, table, EVERY, ROWS, at, look_up(table, at), color) for at in (angles, alike)]
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(found[0], found[2])
    assert torch.equal(found[1], found[3])


@pytest.mark.parametrize("native", [True, False])
def test_a_pixel_that_is_not_a_number_is_checked(monkeypatch: pytest.MonkeyPatch, native: bool) -> None:
    """Be it where the table is even, and in one channel."""
    if not native:
        monkeypatch.setattr(compiled, "library", lambda: None)
    angles = anywhere(3000)
    table = table_of(torch.ones(2 * ROWS**2, dtype=torch.float64))
    color = torch.ones(3000, 3, dtype=torch.float64)
    shaded = look_up(table, angles)
    for channel in range(3):
        for pixel in (1234, 2345):
            broken = shaded.clone()
            broken[pixel, channel] = torch.nan
            assert pixel in chosen_pixels(30, table, EVERY, ROWS, angles, broken, color)


# Images


def flat(tolerance: float = 1e-3, size: int = 96) -> TorchRenderer:
    """A disc of one normal, glossy, whose normals are attacked: it begins at a single place of the table."""
    scene = sphere_scene((size, size), 0.3 + 0.2 * sky(16, 32), ("brushed-metal",))
    gbuffer = sphere_gbuffer(scene)
    facing = gbuffer.normals[size // 2, size // 2] * (gbuffer.coverage > 0)[..., None]
    return TorchRenderer(scene, replace(gbuffer, normals=facing), ("normals",), tolerance)


@torch.no_grad()
def errors_of_a_walk(renderer: TorchRenderer, steps: int = 12) -> list[float]:
    """Errors of the images while every normal walks away, up to 2.4 radians, each in a direction of its own."""
    random = torch.Generator().manual_seed(0)
    start = renderer.initial()["normals"]
    away = 2 * torch.rand(start.shape, generator=random) - 1
    found = []
    for step in range(steps + 1):
        moved = (start + 2.4 * step / steps * away)[None]
        image, exact = (
            one.render({"normals": moved.to(one.initial()["normals"])}) for one in (renderer, renderer.exact())
        )
        found.append(float((image.double() - exact).abs().max()))
    return found


def test_no_image_is_beyond_the_estimate_though_the_table_does_not_hold() -> None:
    renderer = flat()
    assert any(stage.name == "sampled check" for stage in renderer.plan.stages)
    assert max(errors_of_a_walk(renderer)) <= renderer.plan.error <= 1e-3
    assert renderer.failed_checks > 0


def test_without_the_check_the_estimate_does_not_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the check is there for: this is the attack that the estimate used to miss."""
    renderer = flat()
    monkeypatch.setattr(shader_module, "displayed_error", lambda *_: 0.0)
    assert max(errors_of_a_walk(renderer)) > renderer.plan.error


def test_a_table_coarsened_after_it_was_measured_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def coarsened(*arguments: Any) -> tuple[list[Recipe], Plan]:
        recipes, plan = compile_plan(*arguments)
        return [recipe if recipe.rows is None else replace(recipe, rows=recipe.rows // 2) for recipe in recipes], plan

    sound = flat()
    monkeypatch.setattr(renderer_module, "compile_plan", coarsened)
    renderer = flat()
    assert max(errors_of_a_walk(renderer)) <= renderer.plan.error
    errors_of_a_walk(sound)
    assert renderer.failed_checks > sound.failed_checks
    monkeypatch.setattr(shader_module, "displayed_error", lambda *_: 0.0)
    assert max(errors_of_a_walk(renderer)) > 2 * renderer.plan.error


# Gradients


def test_the_plan_states_the_gradients_error() -> None:
    """A coarse table's gradient is measured to be worse than a fine one's; a sum's only rounds."""
    coarse, fine = (flat(tolerance).plan for tolerance in (1e-1, 1e-4))
    assert [one.group for one in coarse.gradients] == ["normals"]
    assert coarse.gradients[0].relative > 5 * fine.gradients[0].relative
    summed = flat(size=12).plan
    assert 0 < summed.gradients[0].relative < 1e-4
    assert summed.gradients[0].wrong_signs < 0.01


def test_no_table_is_chosen_whose_check_fails_in_the_scenes_own_image() -> None:
    """Its pixels would be summed after all in every image. Plastic has highlights that the measured normals miss."""
    thing = {"mesh": "primitive/sphere", "material": "plastic", "scale": 0.73, "color": [0.8, 0.6, 0.4]}
    scene = Scene.model_validate({"objects": [thing], "camera": {"size": [448, 448]}})
    renderer = build(resolve(scene, Library(Settings().cache_dir, Settings().data_dir)), "torch", groups=("normals",))
    assert any(stage.name.startswith("sampled check") for stage in renderer.plan.stages)
    renderer.render({"normals": renderer.initial()["normals"][None]})
    assert isinstance(renderer, TorchRenderer)
    assert renderer.failed_checks == 0
