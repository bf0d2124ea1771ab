"""Point lights, colours and poses, rendered by pyrender: the non-differentiable renderer (paper, section 4.1)."""

from collections.abc import Mapping
from math import inf

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from services.errors import JobFailure
from services.rendering import gl
from services.rendering.display import to_display
from services.rendering.protocol import Parameters
from services.scenes.resolve import ResolvedScene

ENERGY = 30.0
"""Unit of a point light's energy in the group `illumination`, so that all its coordinates are near 1."""

EXPOSURE = 0.5
"""Radiance times this is the linear picture: a white surface that faces the default light from 2.5 away (radiance 2.0
with the ambient light) is just the display's white. EfficientNet-Lite0 does as well from 0.4 to 0.8."""

SAMPLES = 4


class PyrenderRenderer:
    """Images of a scene as a function of its lights, colours and poses.

    Groups, all float tensors: `illumination` [1 + 4 points] (ambient; then per point light its energy / 30 and x, y,
    z), `color` [objects, 3] (linear factor on the mesh's own colours), `translation` [objects, 3] (scene units),
    `rotation` [objects, 3] (rotation vectors, radians). With one object and one light these are the paper's 14 numbers.

    A Lambertian body under a thin glossy coat, lit without shadows or bounces: `shaders/radiance.frag` has the
    formula. Silhouettes are multisampled; the ground is composited as displayed, by coverage. Frames are drawn one
    after another in the process's one OpenGL context, so only the thread that used it first may render.
    """

    name = "pyrender"
    groups = ("illumination", "color", "translation", "rotation")
    differentiable = False

    def __init__(self, scene: ResolvedScene) -> None:
        context = gl.context()
        from services.rendering.drawing import Drawing, View  # imports OpenGL, so after the context

        description = scene.description
        self.backend = context.backend
        self.size = description.camera.size
        self._drawing = Drawing(scene.meshes)
        self._view = View.of(scene.view, scene.projection)
        self._ground = torch.tensor(description.ground, dtype=torch.float32)
        self._scales = [o.scale for o in description.objects]
        lights = [description.lights.ambient]
        for point in description.lights.points:
            lights += [point.energy / ENERGY, *point.position]
        self._points = len(description.lights.points)
        self._initial = {
            "illumination": torch.tensor(lights, dtype=torch.float64),
            "color": torch.tensor([o.color for o in description.objects], dtype=torch.float64),
            "translation": torch.tensor([o.translation for o in description.objects], dtype=torch.float64),
            "rotation": torch.tensor([o.rotation for o in description.objects], dtype=torch.float64),
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

    def names(self, group: str) -> list[str] | None:
        """A word for each number of a group, in order."""
        if group == "illumination":
            points = range(self._points)
            return ["ambient"] + [f"point {i} {word}" for i in points for word in ("energy", "x", "y", "z")]
        words = ("red", "green", "blue") if group == "color" else ("x", "y", "z")
        return [f"object {i} {group} {word}" for i in range(len(self._scales)) for word in words]

    def exact(self) -> "PyrenderRenderer":
        """Itself: it takes no shortcuts."""
        return self

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Images float32 [B, H, W, 3] in [0,1]; `parameters` {group: [B, ...]}. An object out of frame leaves ground.

        Raises JobFailure("non-finite") for parameters or radiances that are not finite, ValueError for unknown groups
        and wrong shapes.
        """
        radiance = self.radiance(parameters)
        coverage = radiance[..., 3:]
        surface = radiance[..., :3] / coverage.clamp_min(1e-6)
        return to_display(EXPOSURE * surface) * coverage + self._ground * (1 - coverage)

    def radiance(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Linear, unclamped radiance times coverage, and coverage: float32 [B, H, W, 4]. Before exposure and display.

        Strictly linear in the ambient light and in each light's energy. Raises as `render` does.
        """
        batch = self._checked(parameters)
        frames = zip(*(batch[group] for group in self.groups), strict=True)
        radiance = torch.from_numpy(np.stack([self._frame(*frame) for frame in frames]))
        if not torch.isfinite(radiance).all():
            raise JobFailure("non-finite", "the picture has values that are not finite: light or colour is too strong")
        return radiance

    def _checked(self, parameters: Mapping[str, Tensor]) -> dict[str, NDArray[np.float64]]:
        sizes = {len(value) for value in parameters.values()}
        if len(sizes) > 1:
            raise ValueError(f"parameters: batches of different sizes {sorted(sizes)}")
        count = sizes.pop() if sizes else 1
        for group, value in parameters.items():
            if group not in self._initial:
                raise ValueError(f"parameters: no group {group!r}; there are {', '.join(self.groups)}")
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

    def _frame(
        self,
        lights: NDArray[np.float64],
        colors: NDArray[np.float64],
        translations: NDArray[np.float64],
        rotations: NDArray[np.float64],
    ) -> NDArray[np.float32]:
        positions, intensities = np.zeros((4, 3)), np.zeros(4)
        points = lights[1:].reshape(-1, 4)
        intensities[: len(points)] = points[:, 0] * ENERGY
        positions[: len(points)] = points[:, 1:]
        poses = np.tile(np.eye(4), (len(self._scales), 1, 1))
        poses[:, :3, :3] = Rotation.from_rotvec(rotations).as_matrix() * np.array(self._scales)[:, None, None]
        poses[:, :3, 3] = translations
        [image] = gl.context().renderer.draw(
            self._drawing,
            "radiance.frag",
            self._view,
            poses,
            colors,
            {"ambient": float(lights[0]), "positions[0]": positions, "intensities[0]": intensities},
            {},
            size=self.size,
            samples=SAMPLES,
            outputs=1,
            blend=True,
        )
        return image
