"""The group `camera` of the pyrender renderer: azimuth, elevation, distance and roll of the scene's camera."""

from math import asin, inf, pi

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from services.rendering.opengl.camera import CameraMatrices
from services.scenes.mesh import FIT_RADIUS
from services.scenes.resolve import ResolvedScene
from services.scenes.view import NEAR, camera_pose

POLES = 0.05
"""Smallest angle between the camera and a pole, radians, unless the scene's own camera is nearer. At a pole azimuth and
roll are the same turn."""


class MovingCamera:
    """The scene's camera as a function of four coordinates: azimuth, elevation and distance as in the scene's
    description, and a roll about the viewing direction. The lens is the scene's.

    initial: float64 [4]. bounds: lowest and highest value of each coordinate, float64 [4]. Azimuth and roll are free.
    The elevation keeps `POLES` from straight above and below. The distance keeps the camera outside the ball about the
    origin that holds all objects where the scene has them, and that ball before the far plane. Over a floor it stays
    above the floor's plane, and the floor stays before the far plane. A scene whose own camera is beyond such a limit
    has its own value for a limit.
    """

    def __init__(self, scene: ResolvedScene) -> None:
        self._projection = scene.projection
        camera = scene.description.camera
        own = torch.tensor([camera.azimuth, camera.elevation, camera.distance, 0.0], dtype=torch.float64)
        radius = max(float(np.linalg.norm(o.translation)) + o.scale * FIT_RADIUS for o in scene.description.objects)
        far = scene.projection[2, 3] / (scene.projection[2, 2] + 1)
        steepest, nearest, furthest = pi / 2 - POLES, radius + NEAR, far - radius
        lowest, floor = -steepest, scene.description.floor
        if floor is not None:
            furthest = min(furthest, far - float(np.linalg.norm((floor.size / 2, floor.height, floor.size / 2))))
            lowest = asin(min(1.0, max(floor.height / nearest, floor.height / furthest)))
        limits = torch.tensor([[-inf, lowest, nearest, -inf], [inf, steepest, furthest, inf]]).double()
        self.initial = own
        self.bounds: tuple[Tensor, Tensor] = (torch.minimum(limits[0], own), torch.maximum(limits[1], own))

    def matrices(self, camera: NDArray[np.float64]) -> CameraMatrices:
        """The camera at coordinates [4]. Positive roll turns it to its own left, so that its image turns to the right
        (clockwise).
        """
        return CameraMatrices.of(camera_pose(*(float(x) for x in camera)), self._projection)
