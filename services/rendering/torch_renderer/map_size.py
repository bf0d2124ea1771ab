"""Chooses the size of an environment map for a tolerance."""

from dataclasses import replace

from services.rendering.opengl.gbuffer import rasterise
from services.rendering.plan import Tolerance
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.scenes.description import MAP_SIZES
from services.scenes.environment import average
from services.scenes.resolve import ResolvedScene


def smallest_map(scene: ResolvedScene, tolerance: Tolerance) -> tuple[int, int]:
    """Returns the smallest of MAP_SIZES whose displayed values are within `tolerance` of those of the largest.

    The values are compared at the pixels that `map_error` samples. The result is the largest size where no smaller one
    suffices, for "exact", and for a scene without a source map (one that was not resolved from a library).
    """
    if scene.source_map is None or tolerance == "exact":
        return MAP_SIZES[-1]
    gbuffer, rotation = rasterise(scene), scene.description.lights.environment.rotation
    for size in MAP_SIZES[:-1]:
        averaged = replace(scene, environment=average(scene.source_map, *size, rotation))
        error = TorchRenderer(averaged, gbuffer, tolerance="exact").plan.environment_map_error
        if error is None or error <= tolerance:
            return size
    return MAP_SIZES[-1]
