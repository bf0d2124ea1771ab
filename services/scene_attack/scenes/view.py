"""Computes camera poses, projections and model matrices, and the visible area of a mesh."""

from math import cos, pi, sin, tan

import numpy as np
from numpy.typing import NDArray

from scene_attack.scenes.description import Camera, SceneObject
from scene_attack.scenes.mesh import Doubles, Mesh

NEAR = 0.01
"""Distance of the near plane from the camera, scene units."""


def camera_to_world(camera: Camera) -> Doubles:
    """Returns the pose of the camera of a scene's description, as `camera_pose` does."""
    return camera_pose(camera.azimuth, camera.elevation, camera.distance, camera.roll)


def camera_pose(azimuth: float, elevation: float, distance: float, roll: float = 0.0) -> Doubles:
    """Returns a camera's pose, float64 [4,4], camera to world; angles in radians, `distance` in scene units.

    The camera looks along its −z at the origin, with its +y upwards. Its position is distance · (sin az · cos el, sin
    el, cos az · cos el). Straight above or below the origin, its +y has the direction that lower elevations tend to at
    the same azimuth. `roll` then turns the camera about its own +z, to its left: what was upright in its image leans to
    the right.
    """
    back = np.array([sin(azimuth) * cos(elevation), sin(elevation), cos(azimuth) * cos(elevation)])
    right = np.array([cos(azimuth), 0.0, -sin(azimuth)])
    up = np.cross(back, right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1] = cos(roll) * right + sin(roll) * up, cos(roll) * up - sin(roll) * right
    pose[:3, 2], pose[:3, 3] = back, distance * back
    return pose


def projection(camera: Camera, far: float) -> Doubles:
    """Returns OpenGL's perspective matrix, float64 [4,4], with the far plane at distance `far`, scene units."""
    height, width = camera.size
    focal = 1 / tan(camera.field_of_view / 2)
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[1, 1] = focal * height / width, focal
    matrix[2, 2], matrix[2, 3] = -(far + NEAR) / (far - NEAR), -2 * far * NEAR / (far - NEAR)
    matrix[3, 2] = -1.0
    return matrix


def rotation_matrix(vectors: Doubles) -> Doubles:
    """Returns rotation matrices [..., 3, 3] of rotation vectors [..., 3] (axis times angle in radians).

    Rodrigues' formula, with K = [v]×: 1 + (sin θ / θ) K + ½ (sin(θ/2) / (θ/2))² K², exact to rounding for any angle.
    """
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    none = np.zeros_like(x)
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(*x.shape, 3, 3)
    angle = np.sqrt(x * x + y * y + z * z)[..., None, None]
    first, second = np.sinc(angle / pi), 0.5 * np.sinc(angle / (2 * pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def model_matrix(placed: SceneObject) -> Doubles:
    """Returns an object's mesh-to-world matrix, float64 [4,4]: translation · rotation · scale."""
    return model_matrices(np.array(placed.translation), np.array(placed.rotation), np.array(placed.scale))


def model_matrices(translations: Doubles, rotations: Doubles, scales: Doubles) -> Doubles:
    """Returns mesh-to-world matrices, float64 [..., 4, 4], as `model_matrix` does.

    translations and rotations (rotation vectors) are [..., 3], scales [...].
    """
    matrices = np.broadcast_to(np.eye(4), (*np.shape(scales), 4, 4)).copy()
    matrices[..., :3, :3] = rotation_matrix(rotations) * scales[..., None, None]
    matrices[..., :3, 3] = translations
    return matrices


def visible_area(mesh: Mesh, to_clip: Doubles, size: tuple[int, int], enough: float) -> float:
    """Returns the summed area of the mesh's triangles inside the frame, in pixels.

    Hidden triangles and back faces count. Triangles that reach behind the camera or out of the frame count with the
    part that is inside. The sum stops once it reaches `enough`. `to_clip` is the matrix from mesh to clip space [4,4];
    `size` is the frame's height and width in pixels.
    """
    total = 0.0
    pixels = np.array([size[1] / 2, size[0] / 2])
    for part in mesh.parts:
        points = (
            np.concatenate([part.vertices.astype(np.float64), np.ones((len(part.vertices), 1))], axis=1) @ to_clip.T
        )
        # Signed distance to each plane of the frustum, one column per plane; inside is positive.
        heights = np.stack([points[:, 3] + sign * points[:, axis] for axis in range(3) for sign in (1, -1)], axis=1)
        inside: NDArray[np.bool_] = heights[part.faces] >= 0
        whole = inside.all(axis=(1, 2))
        screen = points[part.faces[whole]]
        total += float(_areas(screen[..., :2] / screen[..., 3:] * pixels).sum())
        # A triangle with all corners beyond a plane is outside; the others are clipped, until the area is enough.
        for face in part.faces[~whole & np.all(inside.any(axis=1), axis=1)]:
            if total >= enough:
                return total
            polygon = clipped(points[face])
            if len(polygon) >= 3:
                flat = polygon[:, :2] / polygon[:, 3:] * pixels
                fan = np.stack([np.broadcast_to(flat[0], flat[2:].shape), flat[1:-1], flat[2:]], axis=1)
                total += float(_areas(fan).sum())
    return total


def _areas(triangles: Doubles) -> Doubles:
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    areas: Doubles = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    return areas


def clipped(polygon: Doubles) -> Doubles:
    """Returns a convex polygon [n,4] in clip space, clipped to the frustum (Sutherland and Hodgman 1974); [0,4] if
    nothing of it is inside."""
    for axis in range(3):
        for sign in (1, -1):
            if not len(polygon):
                return polygon
            height = polygon[:, 3] + sign * polygon[:, axis]
            after, beyond = np.roll(polygon, -1, axis=0), np.roll(height, -1)
            kept = []
            for here, there, low, high in zip(polygon, after, height, beyond, strict=True):
                if low >= 0:
                    kept.append(here)
                if (low >= 0) != (high >= 0):
                    kept.append(here + (there - here) * (low / (low - high)))
            polygon = np.array(kept).reshape(-1, 4)
    return polygon
