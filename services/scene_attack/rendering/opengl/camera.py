"""The camera, poses and lights of a pass over the geometry, and the part of the image that objects can cover."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scene_attack.rendering.opengl.mesh_upload import Drawing
    from scene_attack.scenes.description import Shadows

Array = NDArray[np.float64]
Rectangle = tuple[int, int, int, int]
"""Rows from and to, columns from and to; the first row is the top."""


def is_in_front(points: Array, clip_from_object: Array) -> bool:
    """Whether homogeneous points [4,V] are all beyond the camera's near plane."""
    height = (clip_from_object[3] + clip_from_object[2]) @ points
    return bool(height.min(initial=np.inf) > 0)


def beyond(points: Array, clip_from_object: Array, margin: float) -> bool:
    """Whether points [4,V] are all beyond one plane of the camera's frustum, by a `margin` in the units they are in."""
    for axis in range(3):
        for sign in (1, -1):
            plane = clip_from_object[3] + sign * clip_from_object[axis]
            if bool((plane @ points).max(initial=-np.inf) < -margin * np.linalg.norm(plane[:3])):
                return True
    return False


def rectangle(points: Sequence[Array], clip_from_object: Sequence[Array], size: tuple[int, int]) -> Rectangle:
    """Returns the part of an image of `size` (height, width) that objects of corners [4, V] can cover; empty if they
    cannot.

    A triangle's image lies within that of its corners as long as these are before the camera; if one is not, it is
    the whole image. A pixel is added around for the rounding of OpenGL's arithmetic.
    """
    height, width = size
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for corners, matrix in zip(points, clip_from_object, strict=True):
        if not is_in_front(corners, matrix):
            return 0, height, 0, width
        x, y, w = matrix[[0, 1, 3]] @ corners
        x, y = x / w, y / w
        low = np.minimum(low, ((1 + x.min()) / 2 * width, (1 - y.max()) / 2 * height))
        high = np.maximum(high, ((1 + x.max()) / 2 * width, (1 - y.min()) / 2 * height))
    left, top = np.clip(np.floor(low) - 1, 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(high) + 1, 0, (width, height)).astype(int)
    if left >= right or top >= bottom:
        return 0, 0, 0, 0
    return int(top), int(bottom), int(left), int(right)


@dataclass(frozen=True)
class CameraMatrices:
    """A camera: clip_from_world [4,4], its position `eye` [3] and unit viewing direction `forward` [3], float64."""

    clip_from_world: Array
    eye: Array
    forward: Array

    @classmethod
    def of(cls, world_from_camera: Array, projection: Array) -> "CameraMatrices":
        """Makes the matrices from a camera-to-world matrix with OpenGL axes (it looks along its -z) and a projection
        matrix.
        """
        camera = np.asarray(world_from_camera, np.float64)
        return cls(np.asarray(projection, np.float64) @ np.linalg.inv(camera), camera[:3, 3], -camera[:3, 2])

    def matrices(self, poses: Array) -> list[dict[str, NDArray[Any]]]:
        """The vertex shader's matrices for each object at its pose [objects, 4, 4]. They are multiplied in float64, so
        that a small move survives the rounding to float32.
        """
        return [
            {
                "clip_from_object": self.clip_from_world @ pose,
                "world_from_object": pose,
                "normal_from_object": np.linalg.inv(pose[:3, :3]).T,
            }
            for pose in poses
        ]


LightCounts = tuple[int, int, int]
"""Numbers of point, directional and spot lights."""


@dataclass(frozen=True)
class RenderPass:
    """A pass over the geometry: the camera; poses [objects, 4, 4] (world from object); the part of the image that is
    drawn; and for each image its ambient light, its lights and the linear factors on the objects' colours [images,
    objects, 3].

    points [images, lights, 4]: intensity, then x, y, z. directionals [images, lights, 4]: irradiance, then the unit
    vector towards the light. spots [images, lights, 9]: intensity, position, unit vector along the axis, and the
    scale and offset of the fall-off (`radiance.frag`). shadows: settings of the shadow maps; None where none are drawn.
    """

    view: CameraMatrices
    poses: Array
    part: Rectangle
    ambients: Array
    points: Array
    colors: Array
    directionals: Array = field(default_factory=lambda: np.zeros((1, 0, 4)))
    spots: Array = field(default_factory=lambda: np.zeros((1, 0, 9)))
    shadows: "Shadows | None" = None

    @property
    def light_counts(self) -> LightCounts:
        """Lights of each image, by kind."""
        return self.points.shape[1], self.directionals.shape[1], self.spots.shape[1]

    @property
    def uniforms(self) -> dict[str, Array]:
        """The lights as uniforms of `radiance.frag`, by name."""
        named = {"ambients[0]": self.ambients}
        points, directionals, spots = self.points.reshape(-1, 4), self.directionals.reshape(-1, 4), self.spots
        if len(points):
            named |= {"positions[0]": points[:, 1:], "intensities[0]": points[:, 0]}
        if len(directionals):
            named |= {"to_suns[0]": directionals[:, 1:], "irradiances[0]": directionals[:, 0]}
        if spots.size:
            energy, place, axis, scale, offset = np.split(spots.reshape(-1, 9), (1, 4, 7, 8), axis=1)
            named |= {"spot_intensities[0]": energy[:, 0], "spot_positions[0]": place, "spot_directions[0]": axis}
            named |= {"spot_scales[0]": scale[:, 0], "spot_offsets[0]": offset[:, 0]}
        return named


def n_watertight_faces(drawing: "Drawing", view: CameraMatrices, poses: Array) -> list[int]:
    """The number of each piece's faces that belong to watertight surfaces; 0 if the object reaches to the camera."""
    in_front = [
        is_in_front(points, view.clip_from_world @ pose) for points, pose in zip(drawing.points, poses, strict=True)
    ]
    return [piece.n_watertight_faces if in_front[piece.index] else 0 for piece in drawing.pieces]


def ordered(drawing: "Drawing", view: CameraMatrices, poses: Array) -> list[int]:
    """Returns the indices of the pieces in drawing order: opaque ones in the scene's order, then the others from far to
    near by the middle of their bounding box.
    """

    def nearness(number: int) -> float:
        piece = drawing.pieces[number]
        pose = poses[piece.index]
        return -float(np.linalg.norm(pose[:3, :3] @ piece.centre + pose[:3, 3] - view.eye))

    solid = [number for number, piece in enumerate(drawing.pieces) if piece.solid]
    return solid + sorted((number for number, piece in enumerate(drawing.pieces) if not piece.solid), key=nearness)
