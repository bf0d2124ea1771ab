"""Radiance of a plane or sphere under one point light and ambient light in closed form, in float64."""

from math import pi

import numpy as np

from scene_attack.scenes.description import Scene
from tests.unit.rendering import shapes


def body_and_coat(
    points: np.ndarray, normals: np.ndarray, eye: np.ndarray, light: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Radiance for one unit of energy of a white Lambertian body, n.l / (pi d^2), and of the coat, in float64.

    The coat is GGX with alpha = 0.45^2 and normal reflectance 0.04, written from Walter et al. 2007 (D, and G as the
    height-correlated Smith form of Heitz 2014) and Schlick 1994.
    """
    to_light, to_eye = np.array(light) - points, eye - points
    distance = np.linalg.norm(to_light, axis=-1)
    l, v = to_light / distance[..., None], to_eye / np.linalg.norm(to_eye, axis=-1)[..., None]
    h = (l + v) / np.linalg.norm(l + v, axis=-1)[..., None]
    nl, nv, nh, vh = ((a * b).sum(-1) for a, b in ((normals, l), (normals, v), (normals, h), (v, h)))
    nl = np.maximum(nl, 0)
    alpha2 = 0.45**4
    tan2 = (1 - nh**2) / nh**2
    d = alpha2 / (pi * nh**4 * (alpha2 + tan2) ** 2)
    smith = [(np.sqrt(1 + alpha2 * (1 - c**2) / np.maximum(c, 1e-6) ** 2) - 1) / 2 for c in (nl, nv)]
    g = 1 / (1 + smith[0] + smith[1])
    f = 0.04 + 0.96 * (1 - vh) ** 5
    coat = d * g * f / (4 * np.maximum(nl, 1e-6) * np.maximum(nv, 1e-6))
    return nl / distance**2 / pi, coat * nl / distance**2


def sky(up: np.ndarray | float) -> np.ndarray:
    """Irradiance / pi per unit of ambient light under a sky of radiance 1 + 0.5 y, for the y of the normal."""
    return 1 + np.asarray(up) / 3


def ambient_coat(normals: np.ndarray, points: np.ndarray, eye: np.ndarray) -> np.ndarray:
    """Ambient light that the coat reflects: Schlick's term, whose rise the roughness of 0.45 damps."""
    v = (eye - points) / np.linalg.norm(eye - points, axis=-1)[..., None]
    return 0.04 + (0.55 - 0.04) * (1 - np.maximum((normals * v).sum(-1), 0)) ** 5


def plane(description: Scene) -> tuple[np.ndarray, ...]:
    """Points [H, W, 3] of the plane z = 0 at the pixel centres, its normal [3] and the camera position [3]."""
    eye, ray = shapes.rays(description.camera)
    return eye + ray * (-eye[2] / ray[..., 2])[..., None], np.array([0.0, 0.0, 1.0]), eye
