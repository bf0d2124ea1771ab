"""How the pieces of a drawing lie before a camera, and in what light: what a pass over the geometry is drawn from."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from services.rendering.opengl.screen_bounds import Rectangle, is_in_front

if TYPE_CHECKING:
    from services.rendering.opengl.mesh_upload import Drawing
    from services.scenes.description import Shadows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CameraMatrices:
    """A camera: clip_from_world [4,4], its position `eye` [3] and unit viewing direction `forward` [3], float64."""

    clip_from_world: Array
    eye: Array
    forward: Array

    @classmethod
    def of(cls, world_from_camera: Array, projection: Array) -> "CameraMatrices":
        """From a camera-to-world matrix with OpenGL axes (it looks along its -z) and a projection matrix."""
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
"""How many point, directional and spot lights there are."""


@dataclass(frozen=True)
class RenderPass:
    """A pass over the geometry: the camera; poses [objects, 4, 4] (world from object); the part of the image that is
    drawn; and for each image its ambient light, its lights and the linear factors on the objects' colours [images,
    objects, 3].

    points [images, lights, 4]: intensity, then x, y, z. directionals [images, lights, 4]: irradiance, then the unit
    vector towards the light. spots [images, lights, 9]: intensity, position, unit vector along the axis, and the
    scale and offset of the fall-off (`radiance.frag`). shadows: how they are drawn; None: they are not.
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
    """Which pieces: opaque ones in the scene's order, then the others from far to near by the middle of their bounding
    box."""

    def nearness(number: int) -> float:
        piece = drawing.pieces[number]
        pose = poses[piece.index]
        return -float(np.linalg.norm(pose[:3, :3] @ piece.centre + pose[:3, 3] - view.eye))

    solid = [number for number, piece in enumerate(drawing.pieces) if piece.solid]
    return solid + sorted((number for number, piece in enumerate(drawing.pieces) if not piece.solid), key=nearness)
