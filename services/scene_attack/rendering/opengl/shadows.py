"""Chooses the lights of a pass that need shadow maps, and the views from which the maps are drawn.

A light needs one map if all that casts a shadow lies before it, else the six sides of a cube around it. The views
depend on the light continuously, and on the objects' poses through a box that is rounded outwards: a small move of an
object leaves the texels where they are, so that differences of images have little noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.opengl.camera import CameraMatrices
from scene_attack.scenes.description import Scene, Shadows

if TYPE_CHECKING:
    from scene_attack.rendering.opengl.camera import RenderPass

Array = NDArray[np.float64]

SIDES = 6
"""Maps of a light among the objects; others need one."""
TEXEL_BYTES = 4
FINER = 2
"""Factor on the texels along a side of a map, and the square root of that on samples, of maps that tell the error."""
MAX_IMAGE_BYTES = 2**30
"""Limit of the memory of one image's shadow maps, bytes, as if all its lights were among the objects."""
MAX_PASS_BYTES = 2**29
"""Limit of the memory of the shadow maps of a pass of several images, bytes, counted as for MAX_IMAGE_BYTES."""


@dataclass(frozen=True)
class PassShadows:
    """The different lights of a pass's images, and the settings of their shadow maps.

    lights [L, 4]: position and 1, or the unit vector towards the light and 0. radii [L]: lengths, or angles in radians.
    of: for each point light of each image, then each directional and each spot light, its number among these.
    resolution: texels a side of a map. samples: of each light.
    """

    lights: Array
    radii: Array
    of: NDArray[np.int64]
    resolution: int
    samples: int

    @property
    def keys(self) -> list[bytes]:
        """A key for each light, made of its place or direction and its radius: lights with equal keys have the same
        maps.
        """
        return [row.tobytes() for row in np.column_stack([self.lights, self.radii])]


def images_per_pass(scene: Scene) -> int:
    """The number of images whose shadow maps fit into the memory of one pass, at least 1."""
    return max(1, MAX_PASS_BYTES // max(1, _image_bytes(scene)))


def check_size(scene: Scene) -> None:
    """Raises InvalidRequest("scene.shadows.resolution") if an image's shadow maps would take more than
    MAX_IMAGE_BYTES."""
    size = _image_bytes(scene)
    if scene.shadows is not None and size > MAX_IMAGE_BYTES:
        raise InvalidRequest(
            "scene.shadows.resolution",
            f"shadow maps of {scene.shadows.resolution} texels a side may take {size / 2**30:.1f} GiB for the scene's "
            f"lights; at most {MAX_IMAGE_BYTES / 2**30:g} GiB",
        )


def finer(shadows: Shadows, lights: int) -> Shadows:
    """Shadows of FINER times as many texels a side and FINER² times as many samples, as far as a scene with so many
    lights may have them."""
    most = int(sqrt(MAX_IMAGE_BYTES / (SIDES * max(1, lights) * TEXEL_BYTES))) // 8 * 8
    resolution = min(FINER * shadows.resolution, 4096, max(shadows.resolution, most))
    samples = min(FINER**2 * shadows.samples, 64)
    return shadows.model_copy(update={"resolution": resolution, "samples": samples})


def _image_bytes(scene: Scene) -> int:
    lights = len(scene.lights.points) + len(scene.lights.directional) + len(scene.lights.spots)
    return 0 if scene.shadows is None else SIDES * lights * TEXEL_BYTES * scene.shadows.resolution**2


def pass_shadows(lit: "RenderPass", shadows: Shadows) -> PassShadows | None:
    """The shadows of a pass; None if it has no lights."""
    kinds = [
        (lit.points[..., 1:4], 1.0, shadows.softness),
        (lit.directionals[..., 1:4], 0.0, shadows.angle),
        (lit.spots[..., 1:4], 1.0, shadows.softness),
    ]
    rows = [
        np.column_stack([places.reshape(-1, 3), np.full(places.size // 3, last), np.full(places.size // 3, radius)])
        for places, last, radius in kinds
    ]
    every = np.concatenate(rows) + 0.0  # never −0
    if not len(every):
        return None
    number: dict[bytes, int] = {}
    of = [number.setdefault(row.tobytes(), len(number)) for row in every]
    different = np.array([np.frombuffer(row) for row in number])
    samples = shadows.samples if different[:, 4].any() else 1
    return PassShadows(different[:, :4].copy(), different[:, 4].copy(), np.array(of), shadows.resolution, samples)


GRID = 16
"""The box of the casters is rounded outwards to multiples of a step: its own largest side, rounded up to a power of 2,
divided by GRID."""
WIDEST = 3.0
"""Largest tangent of a map's half angle (72°); a light that needs more has the six sides of a cube."""
CUBE = 1.1
"""Tangent of the half angle of a cube's sides: they overlap, so that soft shadows have no seams."""
MARGIN = 1.05
"""Width of a map relative to the casters. Above 1, for the samples of a soft shadow's edge."""
PARALLEL = 1e3
"""Distance of a light, in radii of the casters' box, beyond which its rays are taken for parallel: float32 would not
tell its map's texels apart."""
NEAREST = 0.01
"""Least depth of a map, as a share of the largest: objects nearer to a light cast no shadow."""
FLAT = 1e-4
"""Share of an object's size by which others may reach through the plane of its side and still count as standing on it.
"""


@dataclass(frozen=True)
class ShadowView:
    """One shadow map's view, float64: its axes right, up and forward [3, 3] (rows), its origin [3], its half width
    `extent` (a tangent, or a length if `parallel`), and the depths, along forward, of the nearest and farthest casters.
    """

    axes: Array
    origin: Array
    extent: float
    near: float
    far: float
    parallel: bool
    distance: float = 1.0
    """Distance to a point light that is so far away that its rays are taken for parallel; 1 for all other lights."""

    @property
    def camera(self) -> CameraMatrices:
        """The view as a camera of the render pass."""
        into = np.eye(4)
        into[:3, :3], into[:3, 3] = self.axes, -self.axes @ self.origin
        low, high = 0.9 * self.near, 1.1 * self.far
        project = np.zeros((4, 4))
        project[0, 0] = project[1, 1] = 1 / self.extent
        if self.parallel:
            project[2, 2], project[2, 3], project[3, 3] = 2 / (high - low), -(high + low) / (high - low), 1.0
        else:
            project[2, 2], project[2, 3] = (high + low) / (high - low), -2 * high * low / (high - low)
            project[3, 2] = 1.0
        return CameraMatrices(project @ into, self.origin, self.axes[2])

    def spread(self, radius: float) -> float:
        """Returns the largest distance, as a share of the half width, between a fragment's own place on the map and the
        samples of its shadow, for a light of that radius (an angle if parallel) and a fragment far behind the nearest
        caster.
        """
        return (radius * (self.far - self.near) if self.parallel else radius / self.near) / self.extent

    @property
    def row(self) -> Array:
        """The view as `shadows.frag` reads it, [4, 4]."""
        last = (self.extent, float(self.parallel), self.far, self.near)
        return np.column_stack([np.vstack([self.axes, self.origin]), last])


def box_corners(points: Sequence[Array]) -> tuple[list[Array], list[bool]]:
    """The corners [8, 3] of the box of each object, of points [4, V] in its own frame, and whether it has no points
    but these: whether it is a box or a flat rectangle."""
    corners, plain = [], []
    for own in points:
        low, high = own[:3].min(axis=1), own[:3].max(axis=1)
        corners.append(np.array([np.where([k & 1, k & 2, k & 4], high, low) for k in range(8)]))
        at_ends = (own[:3] == low[:, None]) | (own[:3] == high[:, None])
        plain.append(bool(at_ends.all()))
    return corners, plain


def casters(corners: Sequence[Array], plain: Sequence[bool], light: Array) -> list[int]:
    """The indices of the objects that can cast a shadow in a light.

    corners: of each object [8, 3], world space; plain: whether it is a box (`box_corners`). `light` [4] is its position
    and 1, or the direction towards it and 0.

    A box-like object casts none if light and all other objects are before the plane of one of its sides: no ray from
    them to the light passes that plane, and a box hides none of its own lit sides. So the ground is no caster.
    """
    return [k for k in range(len(corners)) if not (plain[k] and _is_behind(k, corners, light))]


def rounded_box(corners: Sequence[Array]) -> tuple[Array, Array]:
    """The rounded box, low and high [3], of objects' corners [8, 3]."""
    points = np.concatenate(corners)
    low, high = points.min(axis=0), points.max(axis=0)
    step = 2.0 ** np.ceil(np.log2(max(float((high - low).max()), 1e-6))) / GRID
    return np.floor(low / step) * step, np.ceil(high / step) * step


def _is_behind(index: int, corners: Sequence[Array], light: Array) -> bool:
    own = corners[index]
    others = [box for k, box in enumerate(corners) if k != index]
    size = float(np.linalg.norm(own[7] - own[0]))
    for axis in range(3):
        a, b = np.array([4, 1, 2])[axis], np.array([2, 4, 1])[axis]
        normal = np.cross(own[a] - own[0], own[b] - own[0])
        length = float(np.linalg.norm(normal))
        if length <= 1e-12 * size**2:
            continue
        for sign, at in ((1.0, own[7]), (-1.0, own[0])):
            # The corner 7 is on the side that the third axis points to.
            outwards = sign * normal / length * np.sign(normal @ (own[7] - own[0]) or 1.0)
            before_light = outwards @ (light[:3] - light[3] * at)
            if before_light > 0 and all(((box - at) @ outwards).min() >= -FLAT * size for box in others):
                return True
    return False


def shadow_views(corners: Sequence[Array], light: Array) -> list[ShadowView]:
    """The views of a light's maps: none, one, or the six sides of a cube. `corners` [8, 3] are those of the
    objects that cast shadows, and `light` [4] is as in `casters`.
    """
    if not corners or not light.any():
        return []
    low, high = rounded_box(corners)
    points = np.array([np.where([k & 1, k & 2, k & 4], high, low) for k in range(8)])
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 or 1.0
    away = centre - light[3] * light[:3]
    distance = float(np.linalg.norm(away))
    if light[3] == 0 or distance > PARALLEL * radius:
        axes = axes_along(away if light[3] else -light[:3])
        return [
            ShadowView(
                axes,
                centre - 2 * radius * axes[2],
                MARGIN * radius,
                0.95 * radius,
                3.05 * radius,
                True,
                distance if light[3] else 1.0,
            )
        ]
    origin = light[:3]
    if distance > 1e-9:
        axes = axes_along(away)
        x, y, depth = ((points - origin) @ axes.T).T
        if depth.min() > NEAREST * depth.max():
            tangent = float(max(np.abs(x / depth).max(), np.abs(y / depth).max()))
            extent = 2.0 ** (np.ceil(8 * np.log2(MARGIN * tangent)) / 8)
            if extent <= WIDEST:
                return [ShadowView(axes, origin, float(extent), float(depth.min()), float(depth.max()), False)]
    far = float(np.abs(points - origin).max())
    inside = np.maximum(np.maximum(low - origin, origin - high), 0.0)
    near = max(NEAREST * far, float(np.linalg.norm(inside)) / 2)
    return [ShadowView(axes_along(side), origin, CUBE, near, far, False) for side in np.vstack([np.eye(3), -np.eye(3)])]


def axes_along(direction: Array) -> Array:
    """Right, up and forward [3, 3] of a view in a direction. They turn continuously with it, but for views straight
    up, as of a light below everything (Frisvad 2012, about -y)."""
    x, y, z = direction / np.linalg.norm(direction)
    if y > 1 - 1e-9:
        return np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]])
    a = 1 / (1 - y)
    return np.array([[1 - x * x * a, x, -x * z * a], [-x * z * a, z, 1 - z * z * a], [x, y, z]])
