"""Dials of a material: five numbers per object that a thing could really have, in place of 108 free coefficients.

They turn the group `material`: ±1 of each is the end of its natural range.

- roughness: highlights are up to `WIDTH` times as wide or narrow. They are then so much lower or higher that light from
  straight above is reflected as before. That is the same plastic from satin to matt: fits of measured rough glass
  differ more (Walter et al. 2007).
- gloss: highlights are up to `GLOSS` times as strong or weak: a plastic of index 1.5 reflects 4 % of the light that
  falls straight on it, and 2 % to 8 % are indices of 1.33 to 1.79. A metal cannot reflect more than falls on it, so its
  gloss only weakens.
- red, green, blue: what has the object's own colour reflects up to `TINT` times as much or little of that channel. A
  grey is then off by ΔE 13 (CIE 1976) at most, within the strongest fading of the scale of ISO 105-A02, 13.6.

The width of a lobe is that of the parabola at its peak: near θ_h = 0, log ρ falls by h(κ) γ θ_h² / 2 with h(κ) =
κ / (1 − e^−κ), and the peak is e^κ − 1. So a peak that is g times as high and w times as wide has

    κ' = log(1 + g (e^κ − 1)),  γ' = γ h(κ) / (h(κ') w²)

at every θ_d. The shifts of log κ and log γ are polynomials of θ_d again: those of least squares at `ANGLES`.
"""

from collections.abc import Sequence
from math import log, pi

import numpy as np
import torch
from torch import Tensor

from scene_attack.rendering.torch.dsbrdf import (
    LOBES,
    LOG_EXPONENT_RANGE,
    LOG_GAMMA_RANGE,
    LOG_KAPPA_RANGE,
    MATERIAL_UNIT,
    basis,
    colored_lobes,
    lobes,
    preset,
    reflectance,
)
from scene_attack.rendering.torch.shading import albedo

NAMES = ("roughness", "gloss", "red", "green", "blue")
WIDTH = 2.0
GLOSS = 2.0
TINT = 1.1
ANGLES = torch.linspace(0.0, pi / 2, 64, dtype=torch.float64)
"""Values of θ_d, radians, at which a material is turned."""


def kinds(materials: Sequence[str]) -> Tensor:
    """Returns for each preset which lobes have the object's colour and which are its gloss, float64 [objects, 2, LOBES]
    of 0 and 1. All lobes of a metal are both; a material that reflects alike in all directions has no gloss."""
    return torch.tensor([_kinds(name) for name in materials], dtype=torch.float64)


def _kinds(name: str) -> tuple[tuple[bool, ...], tuple[bool, ...]]:
    colored = colored_lobes(name)
    if all(colored):
        return colored, (albedo(preset(name) * MATERIAL_UNIT) is None,) * LOBES
    return colored, tuple(not of_body for of_body in colored)


def bounds(of_lobes: Tensor, lightest: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the lowest and highest dials, float64 [objects, 5]. `of_lobes` are the objects' `kinds`; `lightest`
    [objects, 3] is their largest base colour by channel, which no tint makes lighter than white."""
    high = of_lobes.new_ones(len(of_lobes), len(NAMES))
    high[:, 1] -= of_lobes.all(2).all(1).double()
    high[:, 2:] = (-lightest.double().clamp_min(1e-3).log() / log(TINT)).clamp(0.0, 1.0)
    return -torch.ones_like(high), high


def sharpest(of_objects: tuple[Tensor, Tensor]) -> Tensor:
    """Returns the dials [objects, 5] within `bounds` that give the narrowest and strongest highlights, and the lightest
    colours."""
    low, high = of_objects
    return torch.cat([low[:, :1], high[:, 1:]], dim=1)


def turned(material: Tensor, dials: Tensor, of_lobes: Tensor) -> Tensor:
    """Returns materials [objects, 3, LOBES, 2, 6], in the group's unit, turned by `dials` [objects, 5].

    `of_lobes` are the objects' `kinds`. Coefficients stay within the bounds of the group. It is differentiable, and
    without a turn the result has the same bits.
    """
    colored, glossy = of_lobes.to(material)[:, :, None, :].unbind(1)  # [objects, 1, LOBES]
    roughness, gloss, tint = dials[:, None, :1], dials[:, None, 1:2], dials[:, 2:, None]
    gain = log(GLOSS) * gloss * glossy + log(TINT) * tint * colored  # [objects, 3, LOBES]
    wider = log(WIDTH) * roughness * glossy + torch.zeros_like(gain)
    lower = -2 * wider
    lower = lower + reflected(material).log() - reflected(reshaped(material, lower, wider)).log()
    ranges = material.new_tensor([LOG_KAPPA_RANGE, LOG_GAMMA_RANGE]) * MATERIAL_UNIT
    low, high = torch.minimum(ranges[:, :1], material), torch.maximum(ranges[:, 1:], material)
    return reshaped(material, gain + lower, wider).clamp(low, high)


def reshaped(material: Tensor, gain: Tensor, wider: Tensor) -> Tensor:
    """Returns materials [objects, 3, LOBES, 2, 6] whose lobes are exp(gain) times as high and exp(wider) times as wide,
    each [objects, 3, LOBES]."""
    curves = basis(ANGLES)
    fit, curves = (of.to(material) for of in (torch.linalg.pinv(curves), curves))
    kappa = ((material / MATERIAL_UNIT)[..., 0, :] @ curves.T).clamp(*LOG_EXPONENT_RANGE).exp()
    before, after = _shape(kappa, torch.zeros_like(gain)), _shape(kappa, gain)
    shift = torch.stack((after[0] - before[0], before[1] - after[1] - 2 * wider[..., None]), dim=-2) @ fit.T
    return material + MATERIAL_UNIT * shift


def _shape(kappa: Tensor, gain: Tensor) -> tuple[Tensor, Tensor]:
    """log κ and log h(κ) of lobes [objects, 3, LOBES, D] whose peaks are exp(gain) times as high."""
    peak = torch.log1p(torch.expm1(kappa) * gain.exp()[..., None])
    return peak.log(), peak.log() - (-torch.expm1(-peak)).log()


def reflected(material: Tensor) -> Tensor:
    """Returns the share of light from straight above that each lobe reflects, [objects, 3, LOBES], by Gauss's rule:
    the light that goes off at the angle t has θ_h = θ_d = t / 2."""
    nodes, weights = (torch.from_numpy(of) for of in np.polynomial.legendre.leggauss(len(ANGLES)))
    t = (nodes + 1) * (pi / 4)
    log_kappa, gamma = lobes(material / MATERIAL_UNIT, basis(t / 2).to(material))
    weights = (weights * t.sin() * t.cos()).to(material)
    return (reflectance((t / 2).cos().log().to(material), log_kappa, gamma) * weights).sum(-1)
