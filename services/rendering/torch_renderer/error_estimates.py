"""Errors of shading methods: bounds where there are any, measurements at the scene's own pixels otherwise.

All errors are of displayed values in [0,1], the largest over pixels and channels.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log, pi

import torch
from torch import Tensor

from services.rendering.torch_renderer import dsbrdf
from services.rendering.torch_renderer.shader import Recipe, Shader, Sky, Surface, displayed_error
from services.rendering.torch_renderer.units import ILLUMINATION_MEAN

SAMPLED = 4_096
SAMPLED_STILL = 16_384
"""The most pixels that a table is measured at where normals are attacked and where they are not. They are evenly spaced
among the object's pixels, ordered by their normals."""
POINTS = 16_384
"""Normals that a table is measured at where normals are attacked: the sampled pixels and moved copies of them."""
MAX_COPIES = 8
"""The most moved copies of a pixel."""
FIRST_STRIDE = 16
"""Stride through the pixels that are measured first, as most tables fail at a few of them."""
SAMPLED_WIDE = 1_024
"""The most pixels at which float32 is measured against float64."""
STEEPEST = 12.92
"""Slope of the display's curve at black: the most that it magnifies a linear error."""
REACH = {"normals": 0.3, "illumination": 0.36 * ILLUMINATION_MEAN, "material": 3.6}
"""How far draws move each coordinate, either way: normals in a typical success, light and material in 120 steps."""
DRAWS = 2
"""Random draws of light and material that are measured beside the scene's own values."""
TENFOLD = 10.0
"""Where light is attacked, lobes that are left out must not matter under this many times the light, its mean added,
either."""


@dataclass(frozen=True)
class LobeBounds:
    """Bounds [3, LOBES]: of leaving a lobe out, and of taking it for a straight line in log n·h."""

    dark: Tensor
    straight: Tensor


def lobe_bounds(surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], kept: Tensor) -> LobeBounds:
    """Bounds over all normals that a pixel may have."""
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves[kept])
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    if "illumination" in groups:  # a texel that is black may be lit
        illumination = TENFOLD * (illumination + ILLUMINATION_MEAN)
    light = _brightest(surface, sky, illumination, kept)
    # The remainder of the line is half its second derivative times (γ log n·h)², under the cosine n·ω. A seen normal
    # has n·h ≥ n·ω / 2, and t (log t/2)² is at most 1.09; a normal that moves may be anywhere.
    furthest = log(dsbrdf.COSINE_FLOOR) ** 2 if "normals" in groups else 1.09
    curved = 0.5 * exponent * exponent.exp() * (1 + exponent) * gamma.square() * furthest
    return LobeBounds(
        STEEPEST * (torch.expm1(exponent) * light).sum(-1),
        STEEPEST * (curved * light).sum(-1),
    )


def roughness(surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], rows: int) -> Tensor:
    """How badly a table of `rows` fits each texel's light [D of the whole map]: good for ordering texels, no error.

    Two terms. Where a light sets behind the horizon radiance has a kink of slope light · ρ, which Catmull-Rom rounds
    off by about 0.07 of a mesh; there n·h is at most sin θ_d. And a lobe as narrow as the mesh (ρ falls from its peak
    by the part max(1, κ) γ θ² / 2) is lost, wider ones less and less.
    """
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves)
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    light = sky.power * _reached(illumination, groups)
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
    """Whether the recipe's table holds a highlight that can be seen (more than a tenth of `left`) and is narrower than
    its mesh: pixels beside it may all miss it when an error is measured."""
    assert recipe.rows is not None
    held = recipe.active_texels[
        ~torch.isin(recipe.active_texels, recipe.per_pixel_texels.to(recipe.active_texels.device))
    ]
    log_kappa, gamma = dsbrdf.lobes(surface.material, sky.curves[held])
    exponent = log_kappa.clamp(*dsbrdf.LOG_EXPONENT_RANGE).exp()
    light = _brightest(surface, sky, _reached(illumination, groups), held)
    seen = (STEEPEST * torch.expm1(exponent) * light > left / 10) & recipe.varying[..., None]
    return bool((exponent.clamp_min(1.0) * gamma * seen * (pi / recipe.rows) ** 2 > 1).any())


def of_float32(surface: Surface, sky: Sky, illumination: Tensor, recipe: Recipe) -> float:
    """Error of the sum in float32, four times that measured against float64.

    It is largest in narrow highlights. Where normals are attacked they may turn into any, so as many again are measured
    that point anywhere.
    """
    some = subset(surface, SAMPLED_WIDE)
    if recipe.moving:
        random = torch.Generator().manual_seed(1)
        anywhere = torch.rand(some.angles.shape, generator=random, dtype=torch.float64)
        anywhere = (anywhere * torch.tensor([2 * pi, pi]) - torch.tensor([pi, 0.0])).to(some.angles.device)
        some = replace(
            some,
            angles=torch.cat([some.angles, anywhere]),
            base_color=some.base_color.repeat(2, 1),
            viewers=None if some.viewers is None else some.viewers.repeat(2, 1),
        )
    values = [
        Shader(replace(recipe, method="summed", rows=None, moving=True, dtype=dtype), sky, some, illumination)(
            some.angles, illumination, some.material
        )
        for dtype in (torch.float32, torch.float64)
    ]
    return 4 * displayed_error(values[0], values[1], some.base_color)


class Measured:
    """Errors of tables at a surface's pixels, in the scene as it is and after random moves of the attacked groups."""

    def __init__(self, surface: Surface, sky: Sky, illumination: Tensor, groups: Sequence[str], recipe: Recipe) -> None:
        random = torch.Generator().manual_seed(0)
        moving = "normals" in groups
        self._surface = spread(subset(surface, SAMPLED if moving else SAMPLED_STILL), moving, random)
        self._sky, self._illumination = sky, illumination
        self._draws = [(illumination, surface.material)]
        for _ in range(DRAWS if "illumination" in groups or "material" in groups else 0):
            light, material = illumination, surface.material
            if "illumination" in groups:
                light = (light + REACH["illumination"] * _signs(light, random)).clamp_min(0.0)
            if "material" in groups:
                material = material + REACH["material"] * _signs(material, random)
            self._draws.append((light, material))
        self.angles = self._surface.angles
        """The normals [N, 2] at which errors are measured, as angles."""
        self._truth = list(self._values(recipe))

    def error(self, recipe: Recipe, limit: float) -> float:
        """The largest error of `recipe`'s table; the first one found beyond `limit` where there is one."""
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
        """Radiance of each draw at every `stride`-th pixel."""
        plain = replace(recipe, method="summed", moving=True, guard=None)
        some = _every(self._surface, stride)
        shader = Shader(plain, self._sky, some, self._illumination)
        for light, material in self._draws:
            yield shader(some.angles, light, material)


def spread(surface: Surface, moving: bool, random: torch.Generator) -> Surface:
    """The surface at its own normals and, where these are attacked, at copies of them moved at random within reach."""
    angles, again = surface.angles, 1
    if moving:
        again += max(2, min(MAX_COPIES, POINTS // len(angles)))
        steps = [
            torch.rand(angles.shape, generator=random, dtype=torch.float64).to(angles.device) for _ in range(again - 1)
        ]
        angles = torch.cat([angles, *(angles + REACH["normals"] * (2 * step - 1) for step in steps)])
    return replace(surface, angles=angles, base_color=surface.base_color.repeat(again, 1))


def _signs(like: Tensor, random: torch.Generator) -> Tensor:
    return (torch.rand(like.shape, generator=random, dtype=torch.float64) - 0.5).sign().to(like.device)


def subset(surface: Surface, most: int) -> Surface:
    """The surface at `most` of its pixels or fewer, evenly spaced."""
    return _every(surface, -(-len(surface.angles) // most))


def _every(surface: Surface, stride: int) -> Surface:
    """The surface at every `stride`-th of its pixels."""
    viewers = None if surface.viewers is None else surface.viewers[::stride]
    return replace(surface, angles=surface.angles[::stride], base_color=surface.base_color[::stride], viewers=viewers)


def _reached(illumination: Tensor, groups: Sequence[str]) -> Tensor:
    """The most light that the random draws give each texel."""
    return illumination + (REACH["illumination"] if "illumination" in groups else 0.0)


def _brightest(surface: Surface, sky: Sky, illumination: Tensor, kept: Tensor) -> Tensor:
    """Light [3, 1, D] of the kept directions, as reflected by the surface's lightest colour."""
    return ((sky.power * illumination)[:, kept] * surface.base_color.amax(0)[:, None])[:, None]
