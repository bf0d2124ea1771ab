"""What a ray through each sample of a pixel meets: a reference for both rasterisers, in float64 numpy."""

from dataclasses import dataclass
from math import tan

import numpy as np
from numpy.typing import NDArray

from services.scenes.mesh import Doubles, Longs
from services.scenes.resolve import ResolvedScene

Bools = NDArray[np.bool_]

NEAREST = 0.01
"""Nothing closer to the camera than this is seen, scene units."""

RAYS_AT_ONCE = 2**22
"""Rays times triangles held at a time."""


@dataclass(frozen=True)
class Hits:
    """What P pixels show at S samples each. What the first four hold means nothing where `depth` is infinite.

    positions [P, S, 3] and unit normals [P, S, 3] (interpolated, on the viewer's side), world space; colors [P, S, 3],
    linear, without textures; planes [P, S, 3], the unit normals of the flat triangles; depth [P, S] along the view.
    """

    positions: Doubles
    normals: Doubles
    colors: Doubles
    planes: Doubles
    depth: Doubles

    @property
    def coverage(self) -> Doubles:
        """Share of each pixel's samples that meet an object, [P]."""
        return np.asarray(np.isfinite(self.depth).mean(axis=1))

    @property
    def coplanar(self) -> Bools:
        """Whether all samples of a pixel lie in one plane, bool [P]."""
        alike = np.abs(self.planes - self.planes[:, :1]).max(axis=(1, 2)) < 1e-9
        return np.asarray(alike & np.isfinite(self.depth).all(axis=1))

    def mean(self, values: Doubles) -> Doubles:
        """The mean over the samples that meet an object, [P, …]; 0 where none does."""
        hit = np.isfinite(self.depth).reshape(*self.depth.shape, *(1,) * (values.ndim - 2))
        return np.asarray(np.where(hit, values, 0.0).sum(axis=1) / np.maximum(hit.sum(axis=1), 1))


def cast(scene: ResolvedScene, samples: int, pixels: Longs | None = None) -> Hits:
    """Rays through `samples` × `samples` points of each pixel (None: all, row by row), for opaque objects.

    Each triangle by its definition (Möller and Trumbore 1997), both sides, from NEAREST on.
    """
    height, width = scene.description.camera.size
    pixels = np.arange(height * width) if pixels is None else pixels
    eye, rays = scene.view[:3, 3], _rays(scene, samples, pixels)
    depth = np.full(len(rays), np.inf)
    normals, colors, planes = (np.zeros((len(rays), 3)) for _ in range(3))
    for placed in scene.placed:
        model = placed.model
        for part in placed.mesh.parts:
            corners = (part.vertices.astype(np.float64) @ model[:3, :3].T + model[:3, 3] - eye)[part.faces]
            own = (part.normals.astype(np.float64) @ np.linalg.inv(model[:3, :3]))[part.faces]
            step = max(1, RAYS_AT_ONCE // len(rays))
            for start in range(0, len(corners), step):
                t, face, weights = _nearest(rays, corners[start : start + step])
                seen = t < depth
                face += start
                depth[seen] = t[seen]
                colors[seen] = part.color[:3].astype(np.float64) * placed.described.color
                normals[seen] = (weights[:, :, None] * own[face]).sum(axis=1)[seen]
                a, b, c = corners[face[seen]].swapaxes(0, 1)
                planes[seen] = np.cross(b - a, c - a)
    planes = _unit(planes * _sign(-planes, rays))
    positions = eye + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays
    normals = _facing(normals, planes, _unit(-rays))
    shape = (len(pixels), samples**2)
    vectors = [values.reshape(*shape, 3) for values in (positions, normals, colors, planes)]
    return Hits(vectors[0], vectors[1], vectors[2], vectors[3], depth.reshape(shape))


def of_sphere(scene: ResolvedScene, radius: float) -> tuple[Doubles, Bools]:
    """Normals [P, 3] of a sphere about the origin where pixels' middle rays meet it, and which pixels, bool [H·W]:
    those well inside its outline."""
    eye, rays = scene.view[:3, 3], _unit(_rays(scene, 1, np.arange(np.prod(scene.description.camera.size))))
    nearest = -rays @ eye
    miss = np.linalg.norm(eye + nearest[:, None] * rays, axis=1)
    seen = miss < 0.85 * radius
    distance = nearest[seen] - np.sqrt(radius**2 - miss[seen] ** 2)
    return (eye + distance[:, None] * rays[seen]) / radius, seen


def _rays(scene: ResolvedScene, samples: int, pixels: Longs) -> Doubles:
    """Directions [P · samples², 3] from the eye through the samples of pixels [P], of length 1 along the view."""
    height, width = scene.description.camera.size
    rows, columns = np.divmod(pixels, width)
    inside = (np.arange(samples) + 0.5) / samples
    down, across = (axis.ravel() for axis in np.meshgrid(inside, inside, indexing="ij"))
    tangent = tan(scene.description.camera.field_of_view / 2)
    y = (1 - 2 * (rows[:, None] + down) / height).ravel() * tangent
    x = (2 * (columns[:, None] + across) / width - 1).ravel() * tangent * width / height
    right, up, back = (scene.view[:3, k] for k in range(3))
    return np.asarray(x[:, None] * right + y[:, None] * up - back)


def _nearest(rays: Doubles, triangles: Doubles) -> tuple[Doubles, Longs, Doubles]:
    """Distance ≥ NEAREST along each ray (in lengths of the ray; inf for none) to the nearest of the triangles
    [F, 3, 3], which one that is, and the weights [N, 3] of its corners there."""
    origin, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(first, second)
    # With the eye at 0: t = origin·normal / ray·normal, and the barycentric coordinates from the same determinant.
    across, numerator = rays @ normal.T, (origin * normal).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = numerator / across
        u = rays @ np.cross(second, origin).T / across
        v = -(rays @ np.cross(first, origin).T) / across
    inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= NEAREST)
    t = np.where(inside, t, np.inf)
    face = t.argmin(axis=1)
    at = np.arange(len(rays)), face
    hit = np.isfinite(t[at])
    u, v = np.where(hit, u[at], 0.0), np.where(hit, v[at], 0.0)
    return t[at], face, np.stack([1 - u - v, u, v], axis=1)


def _facing(normals: Doubles, planes: Doubles, to_eye: Doubles) -> Doubles:
    """Unit normals on the side from which the flat triangle is seen; one bent beyond the horizon is put on it."""
    normals = _unit(normals * _sign(normals, planes))
    facing = (normals * to_eye).sum(axis=1, keepdims=True)
    return np.where(facing < 0, _unit(normals - facing * to_eye), normals)


def _sign(one: Doubles, other: Doubles) -> Doubles:
    return np.where((one * other).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)


def _unit(vectors: Doubles) -> Doubles:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))
