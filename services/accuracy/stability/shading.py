"""The differentiable renderer of a scene against its definition: images and gradients."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from services.accuracy.stability import definition
from services.accuracy.stability.case import Measured, need
from services.rendering.factory import build
from services.rendering.opengl.gbuffer import GBuffer, rasterise
from services.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from services.rendering.protocol import Parameters, Renderer
from services.scenes.mesh import Doubles
from services.scenes.resolve import ResolvedScene

LOOP = DEFAULT_TOLERANCE
"""Error of a displayed value that the loop's images may have."""

SUMMED = 5e-6
"""The same of a plan that sums every direction at every pixel: sums of positive float32 terms keep 1e-6 of themselves,
and near black the display curve multiplies by up to 12.9."""

SHARP = 2e-5
"""The same under lobes of γ ≥ 1e3: float32 has 5e-7 of log γ, so that much of the exponent γ log n·h is unknown, and
the exponent's own exponential is steep."""

EXACT = 1e-6
"""Error of a displayed value that exact images may have: float64, but normals and base colours are float32."""

GRADIENT = 3e-4
"""Relative error of a gradient of sums, against differences of a float64 definition, which see curvature too."""

LOOKED_AT = 400
"""Pixels whose values are worked out by definition, and the brightest of an image besides."""
BRIGHTEST = 40


@dataclass(frozen=True)
class Errors:
    """Largest error of a displayed value, in the loop's images and in the exact ones, against the definition.

    `clipped` is the share of the pixels looked at with a value beyond display white, by the definition.
    """

    loop: float
    exact: float
    clipped: float

    def within(self, limit: float, what: str) -> Measured:
        """The loop's error against its limit. Raises Broken where the exact image is off."""
        need(self.exact <= EXACT, f"the exact image is off by {self.exact:.1e}")
        return Measured(self.loop, limit, what)


@dataclass(frozen=True)
class Shading:
    """A scene of one object, rendered and by definition. `pixels` [P]: the covered ones that are looked at."""

    scene: ResolvedScene
    renderer: Renderer
    gbuffer: GBuffer
    pixels: Tensor

    @classmethod
    def of(
        cls, scene: ResolvedScene, groups: Sequence[str] | None = None, tolerance: Tolerance = DEFAULT_TOLERANCE
    ) -> "Shading":
        """Rasterises the scene and compiles it for attacks on `groups` (None: all).

        About LOOKED_AT pixels are looked at, evenly spread over the covered ones.
        """
        gbuffer = rasterise(scene)
        covered = gbuffer.coverage.flatten().nonzero()[:, 0]
        renderer = build(scene, "torch", groups=groups, tolerance=tolerance)
        return cls(scene, renderer, gbuffer, covered[:: max(1, len(covered) // LOOKED_AT)])

    @property
    def due(self) -> float:
        """The error that the loop's images may have: LOOP where the plan looks values up, SUMMED where it sums."""
        return LOOP if any("table" in stage.method for stage in self.renderer.plan.stages) else SUMMED

    def defined(self, parameters: Parameters) -> tuple[Doubles, Doubles]:
        """Displayed values [P, 3] by definition at the pixels, and the linear values before clipping."""
        values = {group: value.detach().double().numpy() for group, value in self._all(parameters).items()}
        map_ = np.asarray(self.scene.environment, np.float64)
        if "illumination" not in parameters:
            values["illumination"] = definition.taken_apart(map_)[1]
        light = values["illumination"].reshape(*map_.shape[:2], 1)
        if "illumination_rgb" in parameters:
            light = np.maximum(light + values["illumination_rgb"], 0.0)
        angles = values["normals"].reshape(-1, 2)[self.pixels.numpy()]
        shaded = definition.linear(
            definition.vectors(angles, self.scene.view),
            values["material"][0],
            light,
            map_,
            self.scene.view[:3, 2],
            self.gbuffer.base_color.reshape(-1, 3)[self.pixels].double().numpy(),
            self.scene.description.objects[0].material,
        )
        coverage = self.gbuffer.coverage.flatten()[self.pixels].double().numpy()[:, None]
        ground = np.array(self.scene.description.ground)
        return coverage * definition.displayed(shaded) + (1 - coverage) * ground, shaded

    def errors(self, parameters: Parameters) -> Errors:
        """Images with these values in place of the scene's own ({group: value}), compared. Raises Broken for NaN.

        The brightest pixels are looked at too, so that no highlight is missed.
        """
        images = []
        for renderer in (self.renderer, self.renderer.exact()):
            with torch.no_grad():
                image = renderer.render({g: v[None] for g, v in parameters.items()})[0].reshape(-1, 3).double()
            need(bool(torch.isfinite(image).all()), "the image has values that are not finite")
            need(bool((image >= 0).all() and (image <= 1).all()), "the image has values outside [0,1]")
            images.append(image)
        shown = images[1].sum(dim=1).where(self.gbuffer.coverage.flatten() > 0, -torch.inf)
        brightest = shown.topk(min(BRIGHTEST, len(self.pixels))).indices
        pixels = torch.unique(torch.cat([self.pixels, brightest]))
        wanted, shaded = replace(self, pixels=pixels).defined(parameters)
        loop, exact = (float(np.abs(image[pixels].numpy() - wanted).max()) for image in images)
        return Errors(loop, exact, float((shaded > 1).any(axis=1).mean()))

    def gradient(self, parameters: Parameters, group: str) -> tuple[Tensor, Tensor]:
        """The gradient of ⟨weights, image⟩ with respect to a group, and the weights [P, 3], fixed random numbers."""
        weights = torch.randn(len(self.pixels), 3, generator=torch.Generator().manual_seed(7), dtype=torch.float64)
        values = {g: v.detach().clone() for g, v in parameters.items()}
        leaf = values.setdefault(group, self.renderer.initial()[group]).requires_grad_(True)
        image = self.renderer.render({g: v[None] for g, v in values.items()})[0]
        (gradient,) = torch.autograd.grad((image.reshape(-1, 3)[self.pixels].double() * weights).sum(), leaf)
        need(bool(torch.isfinite(gradient).all()), f"the gradient of {group} has values that are not finite")
        return gradient.double(), weights

    def gradient_error(self, parameters: Parameters, group: str, step: float, mask: Tensor | None = None) -> float:
        """Largest relative error of the gradient along random directions, against differences of the definition.

        Relative to the gradient's own length spread over as many coordinates as it has. `mask`: coordinates to move.
        """
        gradient, weights = self.gradient(parameters, group)
        start = {g: v.detach().double() for g, v in self._all(parameters).items()}
        random = torch.Generator().manual_seed(8)
        worst = 0.0
        for _ in range(3):
            direction = torch.randn(gradient.shape, generator=random, dtype=torch.float64)
            direction = direction if mask is None else direction * mask
            sides = [
                self.defined(start | {group: start[group] + sign * step * direction})[0].ravel() for sign in (1, -1)
            ]
            wanted = float(weights.flatten().numpy() @ (sides[0] - sides[1])) / (2 * step)
            found = float((gradient * direction).sum())
            scale = max(abs(wanted), float((gradient * (direction != 0)).norm()), 1e-12)
            worst = max(worst, abs(found - wanted) / scale)
        return worst

    def _all(self, parameters: Parameters) -> Parameters:
        return self.renderer.initial() | parameters
