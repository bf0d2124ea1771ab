"""Dials of a material by their definition, in numpy: one lobe at a time, with scipy's quadrature and least squares."""

from math import comb, cos, exp, log, pi, sin

import numpy as np
from scipy.integrate import quad

from scene_attack.rendering.torch.dsbrdf import LOG_GAMMA_RANGE, LOG_KAPPA_RANGE, MATERIAL_UNIT

FACTORS = (2.0, 2.0, 1.1, 1.1, 1.1)
BODY, GLOSS = (True, False), (False, True)
LOBES = {
    "matte": (BODY, BODY, BODY),
    "plastic": (BODY, GLOSS, GLOSS),
    "glossy-paint": (BODY, GLOSS, GLOSS),
    "rubber": (BODY, GLOSS, GLOSS),
    "brushed-metal": ((True, True),) * 3,
    "metal": ((True, True),) * 3,
}
"""Of each lobe whether it has the object's colour, and whether it is gloss."""


def curve(coefficients: np.ndarray, theta_d: float) -> float:
    """A Bernstein polynomial on [0, π/2]."""
    t = theta_d / (pi / 2)
    return sum(c * comb(5, i) * t**i * (1 - t) ** (5 - i) for i, c in enumerate(coefficients))


ANGLES = np.linspace(0, pi / 2, 64)
TERMS = np.array([[curve(row, theta) for row in np.eye(6)] for theta in ANGLES])


def width(kappa: float) -> float:
    """The fall of log ρ near its peak, over γ θ² / 2."""
    return kappa / (1 - exp(-kappa))


def reshaped(lobe: np.ndarray, height: float, wider: float) -> np.ndarray:
    """A lobe [2, 6] (natural logarithms) of `height` times the peak and `wider` times the width at each of 64 θ_d."""
    shifts = []
    for theta in ANGLES:
        kappa = exp(curve(lobe[0], theta))
        after = np.log1p(height * np.expm1(kappa))
        shifts.append((log(after / kappa), log(width(kappa) / width(after) / wider**2)))
    return lobe + np.linalg.lstsq(TERMS, np.array(shifts), rcond=None)[0].T


def reflected(lobe: np.ndarray) -> float:
    """Light that a lobe reflects of light from straight above."""

    def density(t: float) -> float:
        exponent = exp(curve(lobe[0], t / 2) + exp(curve(lobe[1], t / 2)) * log(cos(t / 2)))
        return np.expm1(exponent) * sin(t) * cos(t)

    return quad(density, 0, pi / 2, epsabs=0, epsrel=1e-12, limit=200)[0]


def turned(name: str, material: np.ndarray, dials: np.ndarray) -> np.ndarray:
    """A preset's material [3, 3, 2, 6] in the group's unit, or one near it, turned by dials [5]."""
    wider, stronger, *tints = (factor**value for factor, value in zip(FACTORS, dials, strict=True))
    result = material / MATERIAL_UNIT
    for channel, tint in enumerate(tints):
        for k, (colored, glossy) in enumerate(LOBES[name]):
            lobe, w = result[channel, k], wider if glossy else 1.0
            lower = w**-2
            lower *= reflected(lobe) / reflected(reshaped(lobe, lower, w))
            height = (tint if colored else 1.0) * (stronger if glossy else 1.0) * lower
            result[channel, k] = reshaped(lobe, height, w)
    ranges, own = np.array([LOG_KAPPA_RANGE, LOG_GAMMA_RANGE]), material / MATERIAL_UNIT
    return MATERIAL_UNIT * result.clip(np.minimum(ranges[:, :1], own), np.maximum(ranges[:, 1:], own))
