"""Images of the pyrender renderer straight from their definition, in float64 numpy: a reference.

A Lambertian body under a rough dielectric coat, in the textbooks' own form: the GGX distribution (Walter et al. 2007,
equation 33), Smith's height-correlated shadowing from its Λ (Heitz 2014, equation 99), Schlick's Fresnel term. It
shares no code and no constant with services.rendering, and meets the surface by rays.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import cos, pi

import numpy as np

from services.accuracy.stability.definition import displayed
from services.accuracy.stability.rays import cast
from services.scenes.mesh import Doubles, Longs
from services.scenes.resolve import ResolvedScene

ROUGHNESS, NORMAL_REFLECTANCE, EXPOSURE = 0.45, 0.04, 0.5


@dataclass(frozen=True)
class Lamps:
    """Light: ambient radiance; point lights [L, 4], each its radiant intensity and its position; suns [S, 4], each its
    irradiance and the direction in which its light travels; spots [K, 9], each its radiant intensity, its position, the
    direction of its axis, and the angles from the axis where its light begins to fall off and where it ends."""

    ambient: float
    points: Doubles = field(default_factory=lambda: np.zeros((0, 4)))
    suns: Doubles = field(default_factory=lambda: np.zeros((0, 4)))
    spots: Doubles = field(default_factory=lambda: np.zeros((0, 9)))

    def arriving(self, positions: Doubles) -> Iterator[tuple[Doubles, Doubles]]:
        """Each light's irradiance [P, 1] of surfaces that face it, and the unit vectors [P, 3] to it, at points [P, 3].

        Within its outer angle a spot light falls off as KHR_lights_punctual says: with the square of a straight line in
        the cosine.
        """
        for intensity, *place in self.points:
            distance, to_light = _way(positions, place)
            yield intensity / distance**2, to_light
        for irradiance, *travel in self.suns:
            to_light = -np.array(travel) / np.linalg.norm(travel)
            yield np.full((len(positions), 1), irradiance), np.broadcast_to(to_light, positions.shape)
        for intensity, x, y, z, *axis, inner, outer in self.spots:
            distance, to_light = _way(positions, [x, y, z])
            cosine = -to_light @ (np.array(axis) / np.linalg.norm(axis))
            cone = np.clip((cosine - cos(outer)) / (cos(inner) - cos(outer)), 0.0, 1.0) ** 2
            yield intensity * cone[:, None] / distance**2, to_light


Shading = Callable[[Doubles, Doubles, Doubles, Doubles, Lamps], Doubles]
"""A function as `radiance`."""


@dataclass(frozen=True)
class Expected:
    """What some pixels of an image show by definition: radiance [P, 3], and `shown` [P, 3], the displayed values.

    `pixels` [P] are those that lie wholly in one plane of an object: there one point stands for the pixel.
    """

    pixels: Longs
    radiance: Doubles
    shown: Doubles


def expected(
    scene: ResolvedScene, lamps: Lamps | None = None, pixels: Longs | None = None, shading: Shading | None = None
) -> Expected:
    """The image by its definition, of `pixels` (None: all). `lamps`: None for the scene's own; `shading`: of the
    surface, None for the coated body."""
    height, width = scene.description.camera.size
    pixels = np.arange(height * width) if pixels is None else pixels
    pixels = pixels[cast(scene, 4, pixels).coplanar]
    middle = cast(scene, 1, pixels)
    values = (shading or radiance)(
        middle.positions[:, 0],
        middle.normals[:, 0],
        middle.colors[:, 0],
        scene.view[:3, 3],
        lamps or lamps_of(scene),
    )
    return Expected(pixels, values, displayed(EXPOSURE * values))


def lamps_of(scene: ResolvedScene) -> Lamps:
    """The scene's own light."""
    lights = scene.description.lights
    points = [[light.energy, *light.position] for light in lights.points]
    suns = [[light.energy, *light.direction] for light in lights.directional]
    spots = [
        [light.energy, *light.position, *light.direction, light.inner_angle, light.outer_angle]
        for light in lights.spots
    ]
    arrays = (np.array(rows).reshape(-1, width) for rows, width in ((points, 4), (suns, 4), (spots, 9)))
    return Lamps(lights.ambient, *arrays)


def radiance(positions: Doubles, normals: Doubles, colors: Doubles, eye: Doubles, lamps: Lamps) -> Doubles:
    """Linear radiance [P, 3] towards `eye` [3] of points [P, 3] with unit normals [P, 3] and base colours [P, 3].

    The ambient light is a sky of radiance ambient · (1 + w_y / 2) in direction w. A Lambertian body makes
    ambient · (1 + n_y / 3) of it, and the coat adds its Fresnel term, whose rise its roughness damps.
    """
    to_eye = _unit(eye - positions)
    facing = _dot(normals, to_eye)
    gloss = lamps.ambient * _schlick(1 - ROUGHNESS, facing)
    total = lamps.ambient * (1 + normals[:, 1:2] / 3) * colors + gloss
    for facing_it, to_light in lamps.arriving(positions):
        irradiance = facing_it * np.maximum(_dot(normals, to_light), 0.0)
        total = total + irradiance * (colors / pi + _coat(normals, to_eye, to_light))
    return np.asarray(total)


def _coat(normals: Doubles, to_eye: Doubles, to_light: Doubles) -> Doubles:
    """D G F / (4 n·l n·v) [P, 1]; 0 where the light is behind the surface."""
    alpha = ROUGHNESS**2
    half = _unit(to_eye + to_light)
    nh, nl, nv = (np.maximum(_dot(normals, way), 1e-9) for way in (half, to_light, to_eye))
    tangent2 = 1 / nh**2 - 1
    distribution = alpha**2 / (pi * nh**4 * (alpha**2 + tangent2) ** 2)
    shadowing = 1 / (1 + _lambda(nl, alpha) + _lambda(nv, alpha))
    return np.asarray(distribution * shadowing * _schlick(1.0, _dot(to_eye, half)) / (4 * nl * nv))


def _lambda(cosine: Doubles, alpha: float) -> Doubles:
    """Smith's Λ of the GGX distribution."""
    return np.asarray((np.sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2)


def _schlick(grazing: float, cosine: Doubles) -> Doubles:
    return NORMAL_REFLECTANCE + (grazing - NORMAL_REFLECTANCE) * (1 - np.clip(cosine, 0, 1)) ** 5


def _way(positions: Doubles, place: list[float]) -> tuple[Doubles, Doubles]:
    """Distances [P, 1] and unit vectors [P, 3] from points to a place."""
    way = np.array(place) - positions
    distance = np.linalg.norm(way, axis=1, keepdims=True)
    return distance, way / distance


def _dot(one: Doubles, other: Doubles) -> Doubles:
    return np.asarray((one * other).sum(axis=1, keepdims=True))


def _unit(vectors: Doubles) -> Doubles:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
