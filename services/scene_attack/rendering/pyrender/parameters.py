"""The parameters of a scene that the pyrender renderer is a function of: lights, colours, poses, and the camera's
azimuth, elevation, distance and roll.
"""

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from math import cos, inf

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene_attack.errors import JobFailure
from scene_attack.rendering.declaration import DeclaredRenderer
from scene_attack.rendering.opengl.camera import CameraMatrices, LightCounts, Rectangle, RenderPass
from scene_attack.rendering.opengl.shadows import finer
from scene_attack.rendering.pose import MovingCamera
from scene_attack.rendering.protocol import Parameters
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.view import model_matrices

ENERGY = 30.0
"""Unit of a point or spot light's energy in the group `illumination`, so that all its coordinates are near 1."""
IRRADIANCE = 3.0
"""Unit of a directional light's energy there."""
_PLACE, _DIRECTION = ("x", "y", "z"), ("direction x", "direction y", "direction z")
_LIGHTS = (
    ("point", ("energy", *_PLACE), ENERGY),
    ("directional", ("energy", *_DIRECTION), IRRADIANCE),
    ("spot", ("energy", *_PLACE, *_DIRECTION), ENERGY),
)
"""The lights' kinds in the order of the group, the names of their coordinates, and the unit of the first."""


class SceneParameters:
    """Values, bounds and meaning of the groups; `PyrenderRenderer` has their shapes and units.

    What is fixed, and a floor, are drawn with their own colours where they are: no group has a coordinate of them.
    """

    def __init__(self, resolved: ResolvedScene) -> None:
        scene = resolved.description
        self._scales = np.array([o.scale for o in scene.objects])
        fixed = resolved.placed[len(scene.objects) :]
        self._fixed_poses = np.array([placed.model for placed in fixed]).reshape(-1, 4, 4)
        self._fixed_colors = np.array([placed.described.color for placed in fixed]).reshape(-1, 3)
        self._camera = MovingCamera(resolved)
        self.shadows = scene.shadows
        sources = scene.lights
        self._counts: LightCounts = (len(sources.points), len(sources.directional), len(sources.spots))
        lights = [sources.ambient]
        for point in sources.points:
            lights += [point.energy / ENERGY, *point.position]
        for directional in sources.directional:
            lights += [directional.energy / IRRADIANCE, *_unit(np.array(directional.direction))]
        for spot in sources.spots:
            lights += [spot.energy / ENERGY, *spot.position, *_unit(np.array(spot.direction))]
        self._cones = np.array([_cone(spot.inner_angle, spot.outer_angle) for spot in sources.spots]).reshape(-1, 2)
        self._initial = {
            "illumination": torch.tensor(lights, dtype=torch.float64),
            "color": torch.tensor([o.color for o in scene.objects], dtype=torch.float64),
            "translation": torch.tensor([o.translation for o in scene.objects], dtype=torch.float64),
            "rotation": torch.tensor([o.rotation for o in scene.objects], dtype=torch.float64),
            "camera": self._camera.initial,
        }

    def initial(self) -> Parameters:
        """The scene's own values, float64."""
        return {group: value.clone() for group, value in self._initial.items()}

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        """Light is not negative, colours lie in [0,1]; positions, directions and rotations are free. For those of the
        camera see `MovingCamera`.
        """
        dark = torch.tensor([0.0 if name in ("ambient", "energy") else -inf for _, name in self._lights()])
        free = torch.tensor(inf, dtype=torch.float64)
        return {
            "illumination": (dark.double(), free),
            "color": (torch.tensor(0.0, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)),
            "translation": (-free, free),
            "rotation": (-free, free),
            "camera": self._camera.bounds,
        }

    def light_names(self) -> list[str]:
        """A word for each number of `illumination`, in order."""
        return [f"{light} {name}".strip() for light, name in self._lights()]

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
        view: CameraMatrices,
        poses: NDArray[np.float64],
        part: Rectangle,
    ) -> RenderPass:
        """A pass that draws images of those illuminations [images, coordinates] and colours [images, objects, 3]; for
        `poses` see there. The colours of what is fixed are added.
        """
        kinds, start = [], 1
        for count, (_, words, unit) in zip(self._counts, _LIGHTS, strict=True):
            stop = start + count * len(words)
            values = illuminations[:, start:stop].reshape(len(illuminations), count, len(words)).copy()
            values[..., 0] *= unit
            kinds.append(values)
            start = stop
        points, directionals, spots = kinds
        directionals[..., 1:] = -_unit(directionals[..., 1:])
        cones = np.broadcast_to(self._cones, (*spots.shape[:2], 2))
        spots = np.concatenate([spots[..., :4], _unit(spots[..., 4:]), cones], axis=-1)
        fixed = np.broadcast_to(self._fixed_colors, (len(colors), *self._fixed_colors.shape))
        colors = np.concatenate([colors, fixed], axis=1)
        return RenderPass(view, poses, part, illuminations[:, 0], points, colors, directionals, spots, self.shadows)

    def unshadowed(self) -> "SceneParameters":
        """Returns the same for a scene without shadows."""
        plain = copy(self)
        plain.shadows = None
        return plain

    def with_finer_shadows(self) -> "SceneParameters":
        """Returns the same with finer shadow maps, as far as a scene may have them."""
        other = copy(self)
        if self.shadows is not None:
            other.shadows = finer(self.shadows, sum(self._counts))
        return other

    def _lights(self) -> list[tuple[str, str]]:
        """For each coordinate of the group `illumination` its light and its name there."""
        named = [("", "ambient")]
        for count, (kind, words, _) in zip(self._counts, _LIGHTS, strict=True):
            named += [(f"{kind} {i}", word) for i in range(count) for word in words]
        return named

    def view(self, camera: NDArray[np.float64]) -> CameraMatrices:
        """The camera at coordinates [4] of the group `camera`."""
        return self._camera.matrices(camera)

    def poses(self, translations: NDArray[np.float64], rotations: NDArray[np.float64]) -> NDArray[np.float64]:
        """World from object of all that is drawn, [objects, 4, 4]: scaled, turned, moved; of translations and rotations
        [objects, 3]. Those of what is fixed are the last.
        """
        return np.concatenate([model_matrices(translations, rotations, self._scales), self._fixed_poses])


class SceneRenderer(DeclaredRenderer):
    """Base class of renderers with the groups of pyrender: values, labels and bounds of its parameters are those of
    `_numbers`, which a subclass sets.
    """

    _numbers: SceneParameters

    def initial(self) -> Parameters:
        """The scene's own values, float64."""
        return self._numbers.initial()

    def names(self, group: str) -> list[str] | None:
        """A label for each coordinate of a group, in flat order."""
        return self._numbers.light_names() if group == "illumination" else super().names(group)

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        """Returns the bounds of `SceneParameters.bounds`."""
        return self._numbers.bounds()


def recolored(scene: ResolvedScene, perturbation: Parameters) -> ResolvedScene:
    """The scene whose objects have the colours of a perturbation of the group `color`."""
    objects = tuple(
        placed.model_copy(update={"color": tuple((np.array(placed.color) + change.double().numpy()).tolist())})
        for placed, change in zip(scene.description.objects, perturbation["color"], strict=True)
    )
    return replace(scene, description=scene.description.model_copy(update={"objects": objects}))


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors [..., 3] at length 1; one of length 0 stays, and lights nothing."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    units: NDArray[np.float64] = vectors / np.where(lengths > 0, lengths, 1.0)
    return units


def _cone(inner: float, outer: float) -> tuple[float, float]:
    """Scale and offset of a spot light's fall-off, as pyrender and KHR_lights_punctual have them."""
    scale = 1 / max(1e-3, cos(inner) - cos(outer))
    return scale, -cos(outer) * scale
