"""The surfaces that the torch renderer shades: those of each covered pixel, the texels of the environment map that they
see past the scene's objects, and the pixels in shadow.

Geometry is fixed in the torch renderer, so visibility is computed once: from every covered pixel a ray runs towards a
square grid of directions within each texel (kernels/visibility.cpp), and the share of rays that meet nothing is a
factor of the texel's light. Directions below a pixel's own horizon, be it that of its normal or of the triangle that it
is on, are left to the cosine. They count as visible, so that a convex object alone has no shadow, and a normal that an
attack tilts towards them sees their light as it does in a scene without shadows.

Objects cast shadows as they stand in the scene; a part of an opacity below 1 casts none, and the holes of a texture are
taken for closed. A surface point is where the ray through the middle of its samples in the pixel first meets the
triangles, or, at an outline where it meets none of the surface's object, where the G-buffer's depth says.

Where nothing hides any of the light, radiance is a function of the normal alone and every method of shading applies. A
pixel in shadow has a visibility of its own and is summed directly. So the pixels of each object are two regions.

A pixel has one pair of angles among the parameters. Where it shows several surfaces they are those of the surface with
the largest share, and a change of them turns the others by the same angles.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl.gbuffer import Fragments, GBuffer
from scene_attack.rendering.torch import table
from scene_attack.rendering.torch.table import to_angles
from scene_attack.scenes.description import Floor
from scene_attack.scenes.mesh import Doubles, Floats
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.solids import is_convex

OFFSET = 1e-3
"""Distance of a ray's start from the surface along the normal, times the object's scale: more than a finely divided
mesh is off from the round surface that its normals are of, so that its faces cast no shadow on their neighbours."""
INSIDE = 1e-4
"""Share of a ball's radius by which it is taken smaller, so that rounding makes no ray meet it that misses the mesh."""
SIDE = 4
"""Pixels a side of the squares whose rays run together."""
WHOLE = 255
"""Stored visibility of a texel that nothing hides."""


def visibility(scene: ResolvedScene, shown: Fragments) -> Tensor | None:
    """Returns the visibility of each texel from each of the surfaces `shown`, on the CPU, uint8 [D, surfaces] in units
    of 1 / WHOLE; None if the scene has no shadows.

    Raises InvalidRequest("scene.shadows") if there are no compiled kernels.
    """
    shadows = scene.description.shadows
    if shadows is None:
        return None
    if compiled.library() is None:
        raise InvalidRequest(
            "scene.shadows", "the torch renderer needs its compiled kernels for shadows; none are here"
        )
    rows, columns = scene.environment.shape[:2]
    towards = texel_directions(rows, columns, shadows.texel_samples).numpy().astype(np.float32)
    triangles, owners = casters(scene)
    order = _in_squares(shown.pixels, scene.description.camera.size[1])
    starts = tuple(of[order.numpy()] for of in _surface(scene, shown, triangles, owners))
    seen = torch.empty(rows * columns, len(order), dtype=torch.uint8)
    rays = (len(order), *starts, order, len(towards), towards.shape[1], towards)
    objects = (*_by_object(scene, triangles, owners), inner_balls(scene, triangles, owners))
    compiled.call("visibility", torch.float32, *objects, *rays, seen, compiled.threads())
    return seen


def inner_balls(scene: ResolvedScene, triangles: Floats, owners: NDArray[np.int64]) -> Floats:
    """Returns a ball inside each convex object, centre and radius, float32 [objects, 4]; radius 0 for other objects.

    A ray through the ball is stopped by the object whatever triangle it meets: few rays need the others.
    """
    balls = np.zeros((len(scene.placed), 4), np.float32)
    for index, placed in enumerate(scene.placed):
        own = triangles[owners == index].astype(np.float64)
        if not len(own) or not is_convex(placed.mesh):
            continue
        centre = (own.min(axis=(0, 1)) + own.max(axis=(0, 1))) / 2
        a, b, c = np.moveaxis(own, 1, 0)
        across = np.cross(b - a, c - a)
        lengths = np.linalg.norm(across, axis=1)
        heights = ((a - centre) * across).sum(axis=1)[lengths > 0] / lengths[lengths > 0]
        balls[index] = *centre, max(0.0, (1 - INSIDE) * float(heights.min()))
    return balls


def _by_object(scene: ResolvedScene, triangles: Floats, owners: NDArray[np.int64]) -> tuple[Any, ...]:
    """Returns the triangles as the kernels take them: the number of objects, where each one's end, and all of them."""
    count = len(scene.placed)
    return count, np.searchsorted(owners, np.arange(count + 1)).astype(np.int64), triangles


def texel_directions(rows: int, columns: int, side: int) -> Tensor:
    """Returns `side`² unit vectors within each texel, at the middles of parts of equal solid angle, world space,
    float64 [rows·columns, side², 3]."""
    edges = torch.cos(torch.arange(rows + 1, dtype=torch.float64) * (pi / rows))
    middle = (torch.arange(side, dtype=torch.float64) + 0.5) / side
    height = edges[:-1, None] + (edges[1:] - edges[:-1])[:, None] * middle
    if side == 1:  # the texel's own direction, which is at the middle of its angle
        height = torch.cos((torch.arange(rows, dtype=torch.float64) + 0.5) * (pi / rows))[:, None]
    azimuth = (torch.arange(columns, dtype=torch.float64)[:, None] + middle) * (2 * pi / columns)
    y = height[:, None, :, None].expand(rows, columns, side, side)
    phi = azimuth[None, :, None, :].expand(rows, columns, side, side)
    across = (1 - y.square()).clamp_min(0.0).sqrt()
    vectors = torch.stack((across * phi.sin(), y, across * phi.cos()), dim=-1)
    return vectors.reshape(rows * columns, side * side, 3)


def casters(scene: ResolvedScene) -> tuple[Floats, NDArray[np.int64]]:
    """Returns the triangles that cast shadows, float32 [F, 3, 3] in world space, and the object of each, int64 [F],
    ascending."""
    triangles, owners = [np.zeros((0, 3, 3), np.float32)], [np.zeros(0, np.int64)]
    for index, placed in enumerate(scene.placed):
        model = placed.model
        for part in placed.mesh.parts:
            material = part.metallic_roughness
            if part.color[3] < 1 or (material is not None and material.alpha_mode == "BLEND"):
                continue
            corners = part.vertices.astype(np.float64) @ model[:3, :3].T + model[:3, 3]
            triangles.append(corners[part.faces].astype(np.float32))
            owners.append(np.full(len(part.faces), index))
    return np.ascontiguousarray(np.concatenate(triangles)), np.concatenate(owners)


def _in_squares(pixels: Tensor, width: int) -> Tensor:
    """Returns the order of pixels [P] by squares of SIDE × SIDE of the image."""
    row, column = pixels // width, pixels % width
    across = -(-width // SIDE)
    square = (row // SIDE) * across + column // SIDE
    return torch.argsort(square * SIDE**2 + (row % SIDE) * SIDE + column % SIDE)


def camera_rays(scene: ResolvedScene, shown: Fragments) -> Doubles:
    """Returns vectors from the eye through the middle of each surface's samples, one unit long along the viewing
    direction, world space [P, 3]."""
    height, width = scene.description.camera.size
    right, down = shown.place.double().cpu().numpy().T
    pixels = shown.pixels.cpu()
    row, column = (pixels // width).numpy() + down, (pixels % width).numpy() + right
    x = (column * 2 / width - 1) / scene.projection[0, 0]
    y = (1 - row * 2 / height) / scene.projection[1, 1]
    return np.stack([x, y, -np.ones_like(x)], axis=1) @ scene.view[:3, :3].T


def _surface(
    scene: ResolvedScene, shown: Fragments, triangles: Floats, owners: NDArray[np.int64]
) -> tuple[Floats, Floats, Floats, NDArray[np.int64]]:
    """Returns the starts of the surfaces' rays, the G-buffer's normals, and those of the triangles that they are
    on, float32 [P, 3], world space; and the convex objects that are seen from outside there, int64 [P], or -1."""
    rays = camera_rays(scene, shown)
    lengths = np.linalg.norm(rays, axis=1)
    units = np.ascontiguousarray(rays / lengths[:, None], np.float32)
    eye = np.ascontiguousarray(scene.eye, np.float32)
    distances, faces = np.empty(len(units), np.float32), np.empty(len(units), np.int32)
    arguments = (*_by_object(scene, triangles, owners), len(units), eye, units, distances, faces)
    compiled.call("nearest_hits", torch.float32, *arguments, compiled.threads())
    index = shown.object_index.numpy()
    own = (faces >= 0) & (np.append(owners, -1)[faces] == index)
    along = np.where(own, distances / lengths, shown.depth.numpy())
    normals = shown.normals.numpy()
    models = [placed.model for placed in scene.placed]
    scales = np.array([np.linalg.norm(model[:3, 0]) for model in models])[index]
    points = scene.eye + rays * along[:, None] + normals * (OFFSET * scales)[:, None]
    a, b, c = np.moveaxis(triangles[np.where(own, faces, 0)].astype(np.float64), 1, 0)
    facets = np.cross(b - a, c - a)
    away = (facets * rays).sum(axis=1, keepdims=True)
    flat = [isinstance(placed.described, Floor) for placed in scene.placed]
    convex = np.logical_or(flat, [is_convex(placed.mesh) for placed in scene.placed])[index]
    outside = np.where(convex & ~(own & (away[:, 0] > 0)), index, -1)
    facets = np.where(own[:, None], -np.sign(away) * facets, normals)
    points, normals, facets = (np.ascontiguousarray(of, np.float32) for of in (points, normals, facets))
    return points, normals, facets, outside


IN_SHADOW = " in shadow"
"""End of the name of a region from which some of the light is hidden."""


@dataclass(frozen=True)
class Regions:
    """Regions of the covered pixels. `order` [P] sorts the pixels by region and keeps their order within one.

    For each region: `owners`, the object's index; `counts`, its pixels; `names`, its name on plans; `visibilities`,
    uint8 [D, its pixels] in units of 1 / WHOLE, None where nothing is hidden.
    """

    order: Tensor
    owners: list[int]
    counts: list[int]
    names: list[str]
    visibilities: list[Tensor | None]


def regions(owner: Tensor, visibility: Tensor | None, names: Sequence[str], by_shadow: bool = True) -> Regions:
    """Splits pixels that are sorted by their objects' indices, `owner` [P], by their `visibility` [D, P]; `names` are
    those of the objects.

    Every object has a region, be it empty; one with pixels of both kinds has two, the unshadowed pixels first. Without
    `by_shadow` it has one all the same: where the viewer is near, all pixels are summed directly.
    """
    if visibility is None or not by_shadow:
        counts = torch.bincount(owner, minlength=len(names)).tolist()
        order = torch.arange(len(owner), device=owner.device)
        parts: list[Tensor | None] = [None] * len(names)
        if visibility is not None:
            parts = [*torch.split(visibility, counts, dim=1)]
        return Regions(order, list(range(len(names))), counts, list(names), parts)
    shadowed = (visibility < WHOLE).any(0)
    result = Regions(torch.argsort(2 * owner + shadowed, stable=True), [], [], [], [])
    for k, name in enumerate(names):
        for kind, words in ((False, ""), (True, IN_SHADOW)):
            own = ((owner == k) & (shadowed == kind)).nonzero()[:, 0]
            if len(own) or (not kind and not bool((owner == k).any())):
                result.owners.append(k)
                result.counts.append(len(own))
                result.names.append(name + words)
                result.visibilities.append(visibility[:, own] if kind else None)
    return result


@dataclass(frozen=True)
class VisibleSurfaces:
    """The surfaces, sorted by object and then by normal, so that neighbours see the same light.

    image: the angles of each pixel [H, W, 2], 0 where nothing is. shown: the surfaces. angles: theirs [P, 2]. turns:
    their angles minus those of their pixel [P, 2], or None where each pixel shows one surface. Angles are in radians,
    in the camera's frame, float64 rounded to float32, so that the exact renderer renders the same scene.
    """

    image: Tensor
    shown: Fragments
    angles: Tensor
    turns: Tensor | None

    @property
    def ranks(self) -> tuple[Tensor, ...]:
        """The surfaces that are the first of their pixels, the second, and so on; empty where each shows one."""
        if self.turns is None:
            return ()
        return tuple((self.shown.rank == k).nonzero()[:, 0] for k in range(int(self.shown.rank.amax()) + 1))

    def ordered(self, order: Tensor) -> "VisibleSurfaces":
        """Returns the surfaces in another order."""
        turns = None if self.turns is None else self.turns[order]
        return VisibleSurfaces(self.image, self.shown.some(order), self.angles[order], turns)


def visible_surfaces(gbuffer: GBuffer, to_camera: Tensor) -> VisibleSurfaces:
    """Returns the surfaces that a G-buffer shows. `to_camera` [3, 3] turns world vectors, as rows, into the camera's
    frame.
    """
    shown, normals = gbuffer.surfaces(), gbuffer.normals
    if gbuffer.fragments is not None:
        first = shown.rank == 0
        normals = torch.zeros_like(normals)
        normals.view(-1, 3)[shown.pixels[first]] = shown.normals[first]
    image = _rounded(to_angles(normals.to(torch.float64) @ to_camera) * (gbuffer.coverage > 0)[..., None])
    angles = image.reshape(-1, 2)[shown.pixels]
    turns = None
    if gbuffer.fragments is not None:
        own = torch.where(first[:, None], angles, _rounded(to_angles(shown.normals.to(torch.float64) @ to_camera)))
        angles, turns = own, own - angles
    keys = shown.object_index * table.N_SORT_KEYS + table.normal_sort_keys(angles)
    return VisibleSurfaces(image, shown, angles, turns).ordered(torch.argsort(keys, stable=True))


def _rounded(angles: Tensor) -> Tensor:
    return angles.to(torch.float32).to(torch.float64)
