"""Coverage and depth by casting a ray through every sample of every pixel: a reference for the rasteriser."""

from math import tan

import numpy as np

from services.rendering.opengl.gbuffer import FACTOR
from services.scenes.mesh import Doubles
from services.scenes.resolve import ResolvedScene
from services.scenes.view import NEAR

RAYS_AT_ONCE = 2**22
"""Rays times triangles held at a time."""


def cast(scene: ResolvedScene) -> tuple[Doubles, Doubles]:
    """Coverage [H, W] in steps of 1/FACTOR² and mean depth along the view [H, W] of a scene of opaque objects.

    Each triangle by its definition (Möller and Trumbore 1997), both sides, in float64, from NEAR on.
    """
    height, width = scene.description.camera.size
    rows, columns = height * FACTOR, width * FACTOR
    slope = tan(scene.description.camera.field_of_view / 2)
    y = (1 - (2 * np.arange(rows) + 1) / rows) * slope
    x = ((2 * np.arange(columns) + 1) / columns - 1) * slope * width / height
    right, up, back = scene.view[:3, 0], scene.view[:3, 1], scene.view[:3, 2]
    rays = (x[None, :, None] * right + y[:, None, None] * up - back).reshape(-1, 3)
    depth = np.full(len(rays), np.inf)
    for mesh, model in zip(scene.meshes, scene.models, strict=True):
        for part in mesh.parts:
            corners = part.vertices.astype(np.float64) @ model[:3, :3].T + model[:3, 3] - scene.view[:3, 3]
            triangles = corners[part.faces]
            step = max(1, RAYS_AT_ONCE // len(rays))
            for start in range(0, len(triangles), step):
                depth = np.minimum(depth, _nearest(rays, triangles[start : start + step]))
    samples = depth.reshape(height, FACTOR, width, FACTOR).swapaxes(1, 2).reshape(height, width, -1)
    hit = np.isfinite(samples)
    mean = np.where(hit, samples, 0.0).sum(axis=2) / np.maximum(hit.sum(axis=2), 1)
    return hit.mean(axis=2), mean


def _nearest(rays: Doubles, triangles: Doubles) -> Doubles:
    """Smallest distance ≥ NEAR along each ray (in lengths of the ray) to any of the triangles [F, 3, 3]."""
    origin, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    # With the eye at 0: t = origin·normal / ray·normal, and the barycentric coordinates from the same determinant.
    across, numerator = rays @ normal.T, (origin * normal).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = numerator / across
        u = rays @ np.cross(second, origin).T / across
        v = -(rays @ np.cross(first, origin).T) / across
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= NEAR)
    nearest: Doubles = np.where(inside, t, np.inf).min(axis=1)
    return nearest
