"""The error of the environment map's resolution, against images under the larger map."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.torch.planner import PIXELS, looked_at, subset
from scene_attack.rendering.torch.renderer import TorchRenderer, smallest_map
from scene_attack.rendering.torch.shader import Surface
from scene_attack.scenes.description import MAP_SIZES
from scene_attack.scenes.environment import average
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene
from tests.unit.rendering.shadow_scenes import ball, over_ground

pytestmark = pytest.mark.slow

SOURCE = np.kron(sky(16, 32), np.ones((8, 8, 1), np.float32))
"""A map of 128 × 256 texels in blocks of 8 × 8."""


def under(size: tuple[int, int], material: str = "plastic") -> ResolvedScene:
    """A small sphere under the source, averaged down."""
    scene = sphere_scene((14, 14), average(SOURCE, *size), (material,))
    return replace(scene, source_map=SOURCE)


@pytest.mark.parametrize("size", [(4, 8), (16, 32)])
@pytest.mark.parametrize("tolerance", ["exact", 1e-3])
def test_it_is_the_difference_to_the_image_under_the_largest_map(size: tuple[int, int], tolerance: float) -> None:
    """All of so few pixels are looked at, and covered wholly: where the ground shows through, images differ by less."""
    rim = sphere_gbuffer(under(size))
    gbuffer = replace(rim, coverage=(rim.coverage > 0).float())
    own, largest = (TorchRenderer(under(one), gbuffer, tolerance="exact").render({}) for one in (size, MAP_SIZES[-1]))
    wanted = float((own - largest).abs().max())
    assert wanted > 5e-3
    found = TorchRenderer(under(size), gbuffer, tolerance=tolerance).plan.environment_map_error
    assert found == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize("viewer", ["distant", "perspective"])
@pytest.mark.parametrize("tolerance", ["exact", 1e-3])
def test_shadows_under_the_largest_map_are_part_of_the_difference(viewer: str, tolerance: float) -> None:
    """A ball over the ground under lamps: each texel of a small map shadows as one, where those of the largest do not.
    Fewer pixels than are looked at; whose ground shows through, they would differ by less."""
    lamps = np.full((128, 256, 3), 0.1, np.float32)
    lamps[24:32, 40:48] = lamps[30:36, 170:180] = 100.0
    scene = over_ground(ball(), size=(12, 16), viewer=viewer)
    of_size = {
        size: replace(scene, environment=average(lamps, *size), source_map=lamps) for size in ((8, 16), MAP_SIZES[-1])
    }
    drawn = rasterise(scene)
    gbuffer = replace(drawn, coverage=(drawn.coverage > 0).float())
    own, largest = (TorchRenderer(one, gbuffer, tolerance="exact").render({}) for one in of_size.values())
    wanted = float((own - largest).abs().max())
    found = TorchRenderer(of_size[8, 16], gbuffer, tolerance=tolerance).plan.environment_map_error
    assert found == pytest.approx(wanted, abs=1e-5)
    plain = replace(of_size[8, 16], description=scene.description.model_copy(update={"shadows": None}))
    unshadowed = TorchRenderer(plain, gbuffer).plan.environment_map_error
    assert unshadowed is not None
    assert wanted > unshadowed + 0.05


def test_the_looked_at_pixels_are_those_of_the_subsets() -> None:
    """Regions of no pixel, of some, and of more than are looked at."""
    counts = [0, 3, 2 * PIXELS + 1]
    values = torch.arange(sum(counts), dtype=torch.float64)[:, None]
    parts = [Surface("", own.repeat(1, 2), own, torch.zeros(1)) for own in torch.split(values, counts)]
    expected = torch.cat([subset(part, PIXELS).angles[:, 0] for part in parts])
    assert torch.equal(values[looked_at(counts), 0], expected)
    assert len(expected) == 3 + 171  # every third of 513


def test_smaller_maps_cost_more_and_the_largest_nothing() -> None:
    gbuffer = sphere_gbuffer(under((4, 8)))
    found = [TorchRenderer(under(size, "brushed-metal"), gbuffer).plan.environment_map_error for size in MAP_SIZES]
    assert found[-1] is None
    measured = [error for error in found if error is not None]
    assert measured == sorted(measured, reverse=True)


def test_a_map_without_a_source_has_no_error() -> None:
    scene = sphere_scene()
    assert TorchRenderer(scene, sphere_gbuffer(scene)).plan.environment_map_error is None
    assert smallest_map(scene, 1e-3) == MAP_SIZES[-1]
