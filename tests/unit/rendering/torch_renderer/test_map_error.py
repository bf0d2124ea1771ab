"""The error of the environment map's resolution, against images under the larger map."""

from dataclasses import replace

import numpy as np
import pytest

from services.rendering.torch_renderer.map_size import smallest_map
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.scenes.description import MAP_SIZES
from services.scenes.environment import average
from services.scenes.resolve import ResolvedScene
from tests.unit.rendering.shading import sky, sphere_gbuffer, sphere_scene

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
