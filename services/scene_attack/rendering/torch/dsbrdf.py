"""The directional statistics BRDF (Nishino, ICCV 2009), the material model of the paper's differentiable renderer: its
formula, its units, named materials, and the layers of an object.

Per colour channel a material is a sum of lobes,

    ρ(θ_h, θ_d) = Σ_lobes exp(κ(θ_d) · cos^γ(θ_d) θ_h) − 1,

with θ_h the angle between normal and half vector and θ_d the angle between half vector and light. γ near 0 is
Lambertian, large κ and γ a mirror-like lobe. ρ is the whole BRDF, in 1/steradian.

log κ and log γ are polynomials of θ_d held by DEGREE + 1 Bernstein coefficients each, so κ and γ are positive whatever
the coefficients. Bernstein, because its basis functions are positive and sum to 1: bounds on the coefficients bound the
curve, moving all coefficients by s moves the curve by s, and there are no knots to choose.

The paper gives learning rates but not the units of L and m. docs/reports/materials.md says where ours come from. The
named materials are fitted to analytic reference BRDFs by scripts/fit_materials.py.

A dielectric's gloss is reflected at its surface and has the colour of the light; what enters the body and comes out
again, and what a conductor reflects, has the mesh's colour. So the radiance of an object is

    I = base_color · Σ_(coloured lobes) + Σ_(other lobes).

Each layer has a plan of its own. An object whose lobes are all coloured is a single layer. The displayed error of an
object is at most the sum of those of its layers, each taken alone: the display curve is concave, so that light of
another layer only flattens it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import comb, log, pi

import torch
from torch import Tensor

from scene_attack.rendering.torch.declaration import check_preset, stored_presets

ILLUMINATION_MEAN = 10.0
"""Mean over the sphere (weighted by solid angle) of an unperturbed map's intensities. The exposure undoes it, so that
the image does not depend on it: a perturbation of 1 is a tenth of the map's mean."""

MATERIAL_UNIT = 30.0
"""Material coordinates per natural logarithm of κ or γ: a perturbation of 1 scales κ or γ by exp(1/30), about 3 %."""

WHITE = 0.9
"""Linear value to which the exposure scales the brightest channel of the most lit white Lambertian surface."""


CHANNELS, LOBES, DEGREE = 3, 3, 5
SHAPE = (CHANNELS, LOBES, 2, DEGREE + 1)
"""Shape of a material's coefficients: colour channel, lobe, (log κ, log γ), Bernstein coefficient. 108 numbers."""

LOG_KAPPA_RANGE = (log(1e-6), log(1e4))
"""Range of log κ. At the lower end the lobe is dark: it reflects a millionth of the incident light."""
LOG_GAMMA_RANGE = (log(1e-3), log(1e5))
"""Range of log γ. At the lower end the lobe is Lambertian to 1 % of its height."""

COSINE_FLOOR = 1e-4
"""Lower bound of n·h: smaller values (within 0.006° of grazing) are clamped to it before the logarithm is taken, and
their gradient is zero."""

LOG_EXPONENT_RANGE = (-40.0, log(20.0))
"""Range to which log(κ cos^γ θ_h) is clamped, with zero gradient outside. At the upper end ρ = 5e8, orders of magnitude
past display white (the peak of a GGX mirror of roughness 0.1 is about 1e3), and every value computed from it stays
finite in float32. At the lower end ρ = 4e-18 is negligible; smaller numbers would be denormal, which are slow."""


def basis(theta_d: Tensor) -> Tensor:
    """Evaluates the Bernstein polynomials at θ_d in [0, π/2], radians: [D] to [D, DEGREE + 1].

    Every value is ≥ 0, and each row sums to 1.
    """
    t = (theta_d / (pi / 2)).clamp(0.0, 1.0)
    return torch.stack([comb(DEGREE, i) * t**i * (1 - t) ** (DEGREE - i) for i in range(DEGREE + 1)], dim=-1)


def half_vectors(directions: Tensor, viewer: Tensor) -> tuple[Tensor, Tensor]:
    """Returns half vectors [D, 3] and θ_d [D], radians, of light directions [D, 3] and a viewer direction [3].

    All are unit vectors. For light from straight behind the surface the half vector has no direction: it is zero, and
    θ_d is π/2.
    """
    total = directions + viewer
    length = torch.linalg.vector_norm(total, dim=-1)
    theta_d = torch.atan2(torch.linalg.vector_norm(directions - viewer, dim=-1), length)
    opposite = length < 1e-7
    return torch.where(opposite[:, None], 0.0, total / torch.where(opposite, 1.0, length)[:, None]), theta_d


def lobes(coefficients: Tensor, curves: Tensor) -> tuple[Tensor, Tensor]:
    """Evaluates log κ and γ, each [..., D], from coefficients [..., 2, DEGREE + 1].

    `curves` is basis(θ_d) [D, DEGREE + 1]. Both results are clamped to the upper ends of their ranges, with zero
    gradient beyond, so that no coefficient overflows.
    """
    values = coefficients @ curves.T
    return values[..., 0, :].clamp_max(LOG_KAPPA_RANGE[1]), values[..., 1, :].clamp_max(LOG_GAMMA_RANGE[1]).exp()


def reflectance(log_cosine: Tensor, log_kappa: Tensor, gamma: Tensor) -> Tensor:
    """Evaluates one lobe, exp(κ cos^γ θ_h) − 1, from log cos θ_h, log κ and γ, whose shapes broadcast."""
    log_exponent = torch.addcmul(log_kappa, gamma, log_cosine)
    return torch.expm1(log_exponent.clamp(*LOG_EXPONENT_RANGE).exp())


@lru_cache(maxsize=1)
def presets() -> dict[str, Tensor]:
    """Returns all presets, {name: coefficients}, float64 [3, 3, 2, 6].

    The coefficients are natural logarithms of κ and γ, for a white base colour.
    """
    return {
        name: torch.tensor(fit["coefficients"], dtype=torch.float64).reshape(SHAPE)
        for name, fit in stored_presets().items()
    }


def preset(name: str, field: str = "material") -> Tensor:
    """Returns the coefficients of one preset, float64 [3, 3, 2, 6].

    Raises InvalidRequest(field, …) with the nearest names for an unknown name.
    """
    check_preset(name, field)
    return presets()[name].clone()


def colored_lobes(name: str, field: str = "material") -> tuple[bool, ...]:
    """Returns for each lobe of a preset whether the mesh's colour multiplies what it reflects.

    So it is for the body of any material and for the gloss of metals; the gloss of others keeps the light's colour.
    Raises InvalidRequest as `preset` does.
    """
    preset(name, field)
    return tuple(stored_presets()[name]["colored_lobes"])


@dataclass(frozen=True)
class Layer:
    """Lobes of one object. `owner` is the object's index, `words` say on plans which lobes it has, "" for all.

    `share` is the part of the tolerance that its error may take.
    """

    owner: int
    lobes: tuple[int, ...]
    colored: bool
    words: str = ""
    share: float = 1.0

    def material(self, of_object: Tensor) -> Tensor:
        """Returns the layer's coefficients [3, lobes, 2, 6] of an object's [3, LOBES, 2, 6]."""
        whole = len(self.lobes) == of_object.shape[1]
        return of_object if whole else of_object[:, list(self.lobes)]

    def base_color(self, of_object: Tensor) -> Tensor:
        """Returns the factor on the layer's radiance [P, 3], of an object's base colour [P, 3]."""
        return of_object if self.colored else of_object.new_ones(of_object.shape)


def layers(materials: Sequence[str]) -> list[tuple[Layer, ...]]:
    """Returns the layers of each object, whose presets are `materials`. Raises InvalidRequest as `preset` does."""
    return [tuple(_of(owner, name)) for owner, name in enumerate(materials)]


def _of(owner: int, name: str) -> Iterator[Layer]:
    colored = colored_lobes(name, f"scene.objects.{owner}.material")
    chosen = [tuple(lobe for lobe, own in enumerate(colored) if own is kind) for kind in (True, False)]
    words = ("of the body", "of the gloss") if all(chosen) else ("", "")
    share = 0.5 if all(chosen) else 1.0
    for kind, lobes, word in zip((True, False), chosen, words, strict=True):
        if lobes:
            yield Layer(owner, lobes, kind, word, share)
