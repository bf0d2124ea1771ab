"""What is behind the objects in images of the pyrender renderer, whose camera may move."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from services.rendering.pyrender_renderer.batching import Array
from services.rendering.pyrender_renderer.parameters import SceneParameters
from services.scenes.resolve import ResolvedScene

CAMERAS = 32
"""Number of cameras whose view of a map is kept: more than the two sides of each coordinate's difference."""


class Ground:
    """Displayed values behind the objects: one colour [3], or an image [H, W, 3]. A map is seen from each camera; a
    colour and a picture stay as they are.
    """

    def __init__(self, scene: ResolvedScene, parameters: SceneParameters) -> None:
        self._scene = scene
        self._parameters = parameters
        self.at_start = torch.tensor(scene.ground, dtype=torch.float32)
        self._start = parameters.initial()["camera"].numpy().tobytes()
        self._seen = lru_cache(CAMERAS)(self._from)

    def before(self, camera: Array) -> Tensor:
        """What is behind the objects before the camera of coordinates [4]."""
        key = np.asarray(camera, np.float64).tobytes()
        return self.at_start if key == self._start or not self._scene.shows_map else self._seen(key)

    def at(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """As `before`, at parameters {group: [1, ...]}."""
        return self.before(self._parameters.checked(parameters)["camera"][0])

    def before_each(self, cameras: Array, size: tuple[int, int]) -> Tensor:
        """Images [B, H, W, 3] of what is behind the objects before cameras [B, 4]."""
        return torch.stack([self.before(camera).expand(*size, 3) for camera in cameras])

    def _from(self, key: bytes) -> Tensor:
        view = self._parameters.view(np.frombuffer(key, np.float64))
        return torch.tensor(self._scene.ground_from(view.clip_from_world), dtype=torch.float32)

    def part(self, camera: Array, part: tuple[int, int, int, int]) -> Tensor:
        """As `before`, in rows from and to and columns from and to, the bottom row first as OpenGL has them."""
        ground = self.before(camera)
        top, bottom, left, right = part
        return ground if ground.dim() == 1 else ground[top:bottom, left:right].flip(0)
