"""The numbers of a scene that the pyrender renderer is a function of: lights, colours, poses."""

from collections.abc import Mapping
from math import inf

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from services.errors import JobFailure
from services.rendering.opengl.camera import RenderPass
from services.rendering.opengl.screen_bounds import Rectangle
from services.rendering.protocol import Parameters
from services.scenes.description import Scene
from services.scenes.view import model_matrices

ENERGY = 30.0
"""Unit of a point light's energy in the group `illumination`, so that all its coordinates are near 1."""


class SceneParameters:
    """Values, bounds and meaning of the groups; `PyrenderRenderer` has their shapes and units."""

    def __init__(self, scene: Scene) -> None:
        self._scales = np.array([o.scale for o in scene.objects])
        self._points = len(scene.lights.points)
        lights = [scene.lights.ambient]
        for point in scene.lights.points:
            lights += [point.energy / ENERGY, *point.position]
        self._initial = {
            "illumination": torch.tensor(lights, dtype=torch.float64),
            "color": torch.tensor([o.color for o in scene.objects], dtype=torch.float64),
            "translation": torch.tensor([o.translation for o in scene.objects], dtype=torch.float64),
            "rotation": torch.tensor([o.rotation for o in scene.objects], dtype=torch.float64),
        }

    def initial(self) -> Parameters:
        """The scene's own values, float64."""
        return {group: value.clone() for group, value in self._initial.items()}

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        """Light is not negative, colours lie in [0,1]; positions and rotations are free."""
        dark = torch.tensor([0.0] + [0.0, -inf, -inf, -inf] * self._points, dtype=torch.float64)
        free = torch.tensor(inf, dtype=torch.float64)
        return {
            "illumination": (dark, free),
            "color": (torch.tensor(0.0, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)),
            "translation": (-free, free),
            "rotation": (-free, free),
        }

    def checked(self, parameters: Mapping[str, Tensor]) -> dict[str, NDArray[np.float64]]:
        """All groups [B, ...] as float64 arrays, those left out with the scene's values.

        Raises JobFailure("non-finite") for values that are not finite, ValueError for unknown groups and wrong shapes.
        """
        sizes = {len(value) for value in parameters.values()}
        if len(sizes) > 1:
            raise ValueError(f"parameters: batches of different sizes {sorted(sizes)}")
        count = sizes.pop() if sizes else 1
        for group, value in parameters.items():
            if group not in self._initial:
                raise ValueError(f"parameters: no group {group!r}; there are {', '.join(self._initial)}")
            if value.shape[1:] != self._initial[group].shape:
                shape = list(self._initial[group].shape)
                raise ValueError(f"parameters: {group} is {list(value.shape)}, not [B, *{shape}]")
            if not torch.isfinite(value).all():
                raise JobFailure("non-finite", f"{group} has values that are not finite numbers")
        return {
            group: parameters[group].detach().cpu().double().numpy()
            if group in parameters
            else initial.expand(count, *initial.shape).numpy()
            for group, initial in self._initial.items()
        }

    def lit(
        self,
        illuminations: NDArray[np.float64],
        colors: NDArray[np.float64],
        poses: NDArray[np.float64],
        part: Rectangle,
    ) -> RenderPass:
        """A pass that draws pictures of those illuminations [pictures, 1 + 4 points] and colours."""
        points = illuminations[:, 1:].reshape(len(illuminations), self._points, 4) * (ENERGY, 1.0, 1.0, 1.0)
        return RenderPass(poses, part, illuminations[:, 0], points, colors)

    def poses(self, translations: NDArray[np.float64], rotations: NDArray[np.float64]) -> NDArray[np.float64]:
        """World from object [objects, 4, 4]: scaled, turned, moved; of translations and rotations [objects, 3]."""
        return model_matrices(translations, rotations, self._scales)
