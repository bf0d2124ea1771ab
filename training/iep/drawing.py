"""Draws images of scenes, as they are or varied as attacks vary them."""

from math import exp, pi

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from services.rendering.color import to_bytes
from services.rendering.factory import build
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.description import Scene
from services.scenes.library import Library
from services.scenes.resolve import ResolvedScene, resolve

Image = NDArray[np.uint8]

COARSE = {"samples": 4, "texel_samples": 1}
"""Samples of shadows of `coarse`: pyrender's images differ by 0.07/255 in the mean and take two thirds of the time,
those of the torch renderer differ by 0.18/255 and take 0.6 of it."""
BRIGHTER = 0.3
"""Standard deviation of the logarithm of a varied light's energy; half as much for the light from all around."""
MOVED = 0.5
"""Standard deviation of each coordinate of a varied light's position: half of the jitter that every scene has."""
TINTED = 0.04
"""Standard deviation of each channel of a varied object's colour. CLEVR's nearest two, red and brown, are 0.23 apart
in all."""
ROUGHER = 0.1
"""Standard deviation of a varied object's roughness; half as much of its being metallic."""


def draw(scene: Scene, renderer: str, library: Library) -> Image:
    """Returns the exact renderer's image of a scene, uint8 [height, width, 3]."""
    return to_bytes(_image(resolve(scene, library), renderer)).numpy()


def coarse(scene: Scene) -> Scene:
    """Returns a scene with fewer samples of its shadows."""
    assert scene.shadows is not None
    return scene.model_copy(update={"shadows": scene.shadows.model_copy(update=COARSE)})


def _image(scene: ResolvedScene, renderer: str) -> Tensor:
    """Returns the exact renderer's image of a scene as it is, [height, width, 3] in [0,1]."""
    if renderer == "pyrender":  # not by `build`, which checks that an object is in view: `generate` has seen to it
        return PyrenderRenderer(scene, tolerance="exact").render({})[0]
    return build(scene, renderer, tolerance="exact").render({})[0]


def varied(scene: Scene, random: np.random.Generator) -> Scene:
    """Returns a scene with other lights, a turned environment, and slightly other colours and surfaces of its objects.

    The answers to questions stay the same.
    """

    def near(value: float, spread: float) -> float:
        return min(1.0, max(0.0, value + spread * float(random.standard_normal())))

    def brighter(value: float, spread: float) -> float:
        return value * exp(spread * float(random.standard_normal()))

    lights = scene.lights
    points = [
        point.model_copy(
            update={
                "energy": brighter(point.energy, BRIGHTER),
                "position": tuple(float(x) for x in np.add(point.position, MOVED * random.standard_normal(3))),
            }
        )
        for point in lights.points
    ]
    environment = lights.environment.model_copy(update={"rotation": float(random.uniform(-pi, pi))})
    objects = [
        one.model_copy(
            update={
                "color": tuple(near(channel, TINTED) for channel in one.color),
                "roughness": near(one.roughness or 0.0, ROUGHER),
                "metallic": near(one.metallic or 0.0, ROUGHER / 2),
            }
        )
        for one in scene.objects
    ]
    return scene.model_copy(
        update={
            "objects": tuple(objects),
            "lights": lights.model_copy(
                update={
                    "ambient": brighter(lights.ambient, BRIGHTER / 2),
                    "points": tuple(points),
                    "environment": environment,
                }
            ),
        }
    )
