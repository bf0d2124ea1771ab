"""Scenes whose shadows are known in closed form: things over a level square, and rays against every triangle."""

from math import pi
from typing import Any

import numpy as np

from scene_attack.scenes.description import Camera, Lights, Scene, SceneObject, Shadows
from scene_attack.scenes.mesh import Mesh
from scene_attack.scenes.resolve import ResolvedScene
from tests.unit.rendering import shapes

CENTRE, RADIUS = np.array([0.2, 0.6, -0.1]), 0.35
"""Of the ball over the ground."""
LEVEL = (-pi / 2, 0.0, 0.0)
"""Rotation that turns a square facing +z upwards."""


def over_ground(
    *things: tuple[Mesh, SceneObject],
    shadows: Shadows | None = Shadows(),  # noqa: B008 - frozen
    size: tuple[int, int] = (48, 64),
    lights: Lights | None = None,
    **camera: Any,
) -> ResolvedScene:
    """Things over a square of 4 × 4 in the plane y = 0, which is the first object. The torch renderer's materials are
    matte."""
    view = {"size": size, "azimuth": 0.4, "elevation": 0.9, "distance": 4.0} | camera
    objects = (SceneObject(mesh="primitive/plane", rotation=LEVEL), *(thing for _, thing in things))
    description = Scene(camera=Camera(**view), objects=objects, lights=lights or Lights(), shadows=shadows)
    ground = shapes.mesh(shapes.quad(2.0, color=(0.6, 0.5, 0.4, 1)))
    return shapes.placed(description, ground, *(mesh for mesh, _ in things))


def ball(centre: np.ndarray = CENTRE, radius: float = RADIUS) -> tuple[Mesh, SceneObject]:
    """A finely divided ball."""
    own = shapes.mesh(shapes.sphere(radius, color=(0.7, 0.3, 0.3, 1)))
    return own, SceneObject(mesh="primitive/sphere", translation=tuple(float(x) for x in centre))


def square(height: float, half: float, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[Mesh, SceneObject]:
    """A level square at a height."""
    place = (centre[0], height, centre[1])
    return shapes.mesh(shapes.quad(half)), SceneObject(mesh="primitive/plane", translation=place, rotation=LEVEL)


def ground_points(scene: ResolvedScene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The ground's point [H, W, 3] behind each pixel's middle, whether no ball at CENTRE hides it from the camera
    and it is well within the square [H, W], and the camera's place."""
    eye, rays = shapes.rays(scene.description.camera)
    points = eye + rays * (-eye[1] / rays[..., 1])[..., None]
    on = (np.abs(points[..., [0, 2]]) < 1.95).all(-1) & (rays[..., 1] < 0)
    return points, on & (distance_to_line(points, eye - points, CENTRE) > 1.1 * RADIUS), eye


def distance_to_line(points: np.ndarray, towards: np.ndarray, centre: np.ndarray, whole: bool = False) -> np.ndarray:
    """Distance of a centre from the half-lines from points [..., 3] towards a direction [..., 3]; infinite behind, and
    with `whole` beyond the direction's end."""
    lengths = np.linalg.norm(towards, axis=-1, keepdims=True)
    units = towards / lengths
    away = centre - points
    along = (away * units).sum(-1)
    there = (along > 0) & (~np.bool_(whole) | (along < lengths[..., 0]))
    return np.where(there, np.linalg.norm(away - along[..., None] * units, axis=-1), np.inf)


def meets(origins: np.ndarray, directions: np.ndarray, triangles: np.ndarray, reach: float = np.inf) -> np.ndarray:
    """Whether half-lines [N, 3] meet any of triangles [F, 3, 3] before `reach`, by the signs of volumes; bool [N]."""
    found = np.zeros(len(origins), bool)
    for a, b, c in triangles.astype(np.float64):
        at, bt, ct = a - origins, b - origins, c - origins
        volumes = [(np.cross(p, q) * directions).sum(-1) for p, q in ((at, bt), (bt, ct), (ct, at))]
        inside = (np.array(volumes) > 0).all(0) | (np.array(volumes) < 0).all(0)
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (at @ normal) / (directions @ normal)
        found |= inside & (distance > 0) & (distance < reach)
    return found
