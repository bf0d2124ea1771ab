"""Estimates the errors of shading methods: by bounds where they exist, else by measuring at the scene's own pixels.

Every error is a difference of displayed values in [0,1], the largest over pixels and channels.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log, pi

import torch
from torch import Tensor

from services.rendering.torch_renderer import dsbrdf
from services.rendering.torch_renderer.environment_light import LIGHT_GROUPS, attacks_light
from services.rendering.torch_renderer.shader import Recipe, Shader, Sky, Surface, displayed_error
from services.rendering.torch_renderer.units import ILLUMINATION_MEAN

MAX_PIXELS_MOVING_NORMALS = 4_096
MAX_PIXELS_FIXED_NORMALS = 16_384
"""Maximum number of pixels at which a table is measured, where normals are attacked and where they are not. The pixels
are evenly spaced among the object's pixels, ordered by their normals."""
N_NORMALS = 16_384
"""Number of normals at which a table is measured where normals are attacked: those of the sampled pixels and randomly
perturbed copies of them."""
MAX_COPIES = 8
"""Maximum number of perturbed copies of each sampled pixel."""
FIRST_STRIDE = 16
"""Stride through the pixels of a first, coarse measurement: most tables already fail there."""
MAX_PIXELS_FLOAT64 = 1_024
"""Maximum number of pixels at which float32 is measured against float64."""
MAX_DISPLAY_DERIVATIVE = 12.92
"""Derivative of the sRGB curve at black: the largest factor by which the curve magnifies a linear error."""
MAX_PERTURBATION = {"normals": 0.3, "material": 3.6} | dict.fromkeys(LIGHT_GROUPS, 0.36 * ILLUMINATION_MEAN)
"""Largest random perturbation of a coordinate, by group: that of normals in a typical successful attack, those of
light and material in 120 steps of the paper's size."""
N_PERTURBATIONS = 2
"""Number of random perturbations of light and material at which a table is measured, besides the scene's own values."""
MAX_LIGHT_GAIN = 10.0
"""Factor by which light may grow where it is attacked: a lobe is left out only if it is negligible under the light plus
its mean, times this factor."""


@dataclass(frozen=True)
class LobeBounds:
    """Error bounds [3, lobes] by channel and lobe.

    dark: the error of leaving the lobe out. straight: the error of replacing it by a straight line in log n·h.
    """

    dark: Tensor
    straight: Tensor


def lobe_bounds(surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], kept: Tensor) -> LobeBounds:
    """Bounds the errors of simplifying lobes, over all normals that a pixel may have.

    `illumination` [D of the whole map]; `kept` holds the indices of the texels that are used.
    """
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves[kept])
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    if attacks_light(groups):  # the attack may light a black texel
        illumination = MAX_LIGHT_GAIN * (illumination + ILLUMINATION_MEAN)
    light = _brightest(surface, sky, illumination, kept)
    # The remainder of the line is half its second derivative times (γ log n·h)², under the cosine n·ω. A seen normal
    # has n·h ≥ n·ω / 2, and t (log t/2)² is at most 1.09; a normal that moves may be anywhere.
    furthest = log(dsbrdf.COSINE_FLOOR) ** 2 if "normals" in groups else 1.09
    curved = 0.5 * exponent * exponent.exp() * (1 + exponent) * gamma.square() * furthest
    return LobeBounds(
        MAX_DISPLAY_DERIVATIVE * (torch.expm1(exponent) * light).sum(-1),
        MAX_DISPLAY_DERIVATIVE * (curved * light).sum(-1),
    )


def roughness(surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], rows: int) -> Tensor:
    """Scores how badly a table of `rows` rows interpolates each texel's light, [D of the whole map].

    The score orders texels; it is not an error. It has two terms. Where a light sets behind the horizon, radiance has
    a kink of slope light · ρ, which Catmull-Rom interpolation rounds off by about 0.07 of the mesh width; there n·h is
    at most sin θ_d. And a lobe as narrow as the mesh (ρ falls from its peak by the fraction max(1, κ) γ θ² / 2) is
    missed; wider lobes lose less.
    """
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves)
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    light = sky.power * _brightest_texels(illumination, groups)
    cosine = (sky.directions.half[:3] * sky.directions.towards).sum(0).clamp(0.0, 1.0)
    sine = (1 - cosine.square()).clamp_min(1e-8).sqrt()
    mesh = pi / rows
    at_horizon = dsbrdf.reflectance(sine.log(), log_kappa, gamma).sum(1)
    narrow = (mesh**2 * exponent.clamp_min(1.0) * gamma).clamp_max(1.0) ** 1.5
    peak = (torch.expm1(exponent) * narrow).sum(1) * cosine
    return ((0.07 * mesh * at_horizon + 0.05 * peak) * light).amax(0)


def too_narrow(
    surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe, left: float
) -> bool:
    """Returns whether the recipe's table contains a visible highlight that is narrower than its mesh.

    Visible means brighter than a tenth of `left`, the tolerance that remains. The sampled pixels may all miss such a
    highlight, so a measured error would be too small.
    """
    assert recipe.rows is not None
    held = recipe.active_texels[
        ~torch.isin(recipe.active_texels, recipe.per_pixel_texels.to(recipe.active_texels.device))
    ]
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves[held])
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    light = _brightest(surface, sky, _brightest_texels(illumination, groups), held)
    seen = (MAX_DISPLAY_DERIVATIVE * torch.expm1(exponent) * light > left / 10) & recipe.varying[..., None]
    return bool((exponent.clamp_min(1.0) * gamma * seen * (pi / recipe.rows) ** 2 > 1).any())


def float32_error(surface: Surface, sky: Sky, illumination: Tensor, recipe: Recipe) -> float:
    """Estimates the error of the sum in float32: four times the error measured against float64.

    It is largest in narrow highlights. Attacked normals may turn in any direction, so the measurement then adds an
    equal number of random normals.
    """
    sample = subset(surface, MAX_PIXELS_FLOAT64)
    if recipe.moving:
        random = torch.Generator().manual_seed(1)
        anywhere = torch.rand(sample.angles.shape, generator=random, dtype=torch.float64)
        anywhere = (anywhere * torch.tensor([2 * pi, pi]) - torch.tensor([pi, 0.0])).to(sample.angles.device)
        sample = replace(
            sample,
            angles=torch.cat([sample.angles, anywhere]),
            base_color=sample.base_color.repeat(2, 1),
            viewers=None if sample.viewers is None else sample.viewers.repeat(2, 1),
            visibility=None if sample.visibility is None else sample.visibility.repeat(1, 2),
        )
    values = [
        Shader(replace(recipe, method="summed", rows=None, moving=True, dtype=dtype), sky, sample, illumination)(
            sample.angles, illumination, sample.material
        )
        for dtype in (torch.float32, torch.float64)
    ]
    return 4 * displayed_error(values[0], values[1], sample.base_color)


class MeasuredErrors:
    """Measures errors of tables at a surface's pixels, for the scene's own values and random perturbations of them."""

    def __init__(self, surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe) -> None:
        random = torch.Generator().manual_seed(0)
        moving = "normals" in groups
        self._surface = spread(
            subset(surface, MAX_PIXELS_MOVING_NORMALS if moving else MAX_PIXELS_FIXED_NORMALS), moving, random
        )
        self._sky, self._illumination = sky, illumination
        self._perturbed = [(illumination, surface.material)]
        for _ in range(N_PERTURBATIONS if attacks_light(groups) or "material" in groups else 0):
            light, material = illumination, surface.material
            if "illumination" in groups:
                light = (light + MAX_PERTURBATION["illumination"] * _signs(light, random)).clamp_min(0.0)
            if "illumination_rgb" in groups:
                light = light.expand(3, -1)
                light = (light + MAX_PERTURBATION["illumination_rgb"] * _signs(light, random)).clamp_min(0.0)
            if "material" in groups:
                material = material + MAX_PERTURBATION["material"] * _signs(material, random)
            self._perturbed.append((light, material))
        self.angles = self._surface.angles
        """The normals at which errors are measured: azimuth and polar angle [N, 2], radians."""
        self._truth = list(self._values(recipe))

    def error(self, recipe: Recipe, limit: float) -> float:
        """Returns the largest error of `recipe`'s table, or the first error found that exceeds `limit`."""
        largest = 0.0
        for stride in (FIRST_STRIDE, 1):
            color = self._surface.base_color[::stride]
            for value, truth in zip(self._values(recipe, stride), self._truth, strict=True):
                largest = max(largest, displayed_error(value, truth[::stride], color))
                if largest > limit:
                    return largest
        return largest

    @torch.no_grad()
    def _values(self, recipe: Recipe, stride: int = 1) -> Iterator[Tensor]:
        """Yields the radiance [P, 3] of each perturbation at every `stride`-th pixel."""
        plain = replace(recipe, method="summed", moving=True, guard=None)
        sample = _every(self._surface, stride)
        shader = Shader(plain, self._sky, sample, self._illumination)
        for light, material in self._perturbed:
            yield shader(sample.angles, light, material)


def spread(surface: Surface, moving: bool, random: torch.Generator) -> Surface:
    """Returns the surface with its own normals and, if `moving`, randomly perturbed copies of them."""
    angles, again = surface.angles, 1
    if moving:
        again += max(2, min(MAX_COPIES, N_NORMALS // len(angles)))
        steps = [
            torch.rand(angles.shape, generator=random, dtype=torch.float64).to(angles.device) for _ in range(again - 1)
        ]
        angles = torch.cat([angles, *(angles + MAX_PERTURBATION["normals"] * (2 * step - 1) for step in steps)])
    seen = None if surface.visibility is None else surface.visibility.repeat(1, again)
    return replace(surface, angles=angles, base_color=surface.base_color.repeat(again, 1), visibility=seen)


def _signs(like: Tensor, random: torch.Generator) -> Tensor:
    return (torch.rand(like.shape, generator=random, dtype=torch.float64) - 0.5).sign().to(like.device)


def subset(surface: Surface, max_pixels: int) -> Surface:
    """Returns the surface at no more than `max_pixels` of its pixels, evenly spaced."""
    return _every(surface, stride(len(surface.angles), max_pixels))


def stride(n_pixels: int, max_pixels: int) -> int:
    """Returns the stride through pixels that leaves no more than `max_pixels` of them, at least 1."""
    return max(1, -(-n_pixels // max_pixels))


def _every(surface: Surface, stride: int) -> Surface:
    """Returns the surface at every `stride`-th of its pixels."""
    viewers = None if surface.viewers is None else surface.viewers[::stride]
    seen = None if surface.visibility is None else surface.visibility[:, ::stride]
    angles, color = surface.angles[::stride], surface.base_color[::stride]
    return replace(surface, angles=angles, base_color=color, viewers=viewers, visibility=seen)


def _brightest_texels(illumination: Tensor, groups: Sequence[str]) -> Tensor:
    """Returns the largest intensity that the random perturbations give each texel."""
    return illumination + sum(MAX_PERTURBATION[group] for group in LIGHT_GROUPS if group in groups)


def _brightest(surface: Surface, sky: Sky, illumination: Tensor, kept: Tensor) -> Tensor:
    """Returns the light [3, 1, D] of the kept directions times the surface's lightest base colour."""
    return ((sky.power * illumination)[:, kept] * surface.base_color.amax(0)[:, None])[:, None]
