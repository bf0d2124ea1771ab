"""The image of the differentiable renderer straight from its definition, in float64 numpy: a reference.

Shares no code and no constant with services.rendering: world space where the renderer works in the camera's, no bounds
on exponents (what overflows is infinitely bright, and displayed as 1), every direction and lobe at once.
"""

from math import comb, pi

import numpy as np

from services.scenes.mesh import Doubles

ILLUMINATION_MEAN, MATERIAL_UNIT, WHITE = 10.0, 30.0, 0.9
"""Mean intensity of a map; material coordinates per natural logarithm; the brightest white surface's linear value."""

UNCOLORED = {"plastic": (1, 2), "glossy-paint": (1, 2)}
"""Lobes of dielectrics' gloss by preset: the mesh's colour does not multiply what they reflect."""

COSINE_FLOOR = 1e-4
"""The lowest n·h that a lobe sees."""


def texels(rows: int, cols: int) -> tuple[Doubles, Doubles]:
    """Directions [rows·cols, 3] and solid angles [rows·cols] of a map's texels (services.scenes.environment)."""
    theta, phi = (np.arange(rows) + 0.5) * pi / rows, (np.arange(cols) + 0.5) * 2 * pi / cols
    ring = np.stack([np.sin(phi), np.zeros(cols), np.cos(phi)], axis=1)
    towards = np.sin(theta)[:, None, None] * ring + np.cos(theta)[:, None, None] * np.array([0.0, 1.0, 0.0])
    # 2 sin θ sin(Δθ/2) Δφ: the difference of two cosines without cancellation.
    solid = 2 * np.sin(theta) * np.sin(pi / rows / 2) * 2 * pi / cols
    return towards.reshape(-1, 3), np.repeat(solid, cols)


def taken_apart(radiance: Doubles) -> tuple[Doubles, Doubles, float]:
    """Chroma [D, 3], intensity [D] and exposure of a map [rows, cols, 3] with some light in it."""
    rows, cols, _ = radiance.shape
    towards, solid = texels(rows, cols)
    flat = radiance.reshape(-1, 3).astype(np.float64)
    luminance = flat @ (0.2126, 0.7152, 0.0722)
    chroma = np.ones_like(flat)
    lit = luminance > 0
    chroma[lit] = flat[lit] / luminance[lit, None]
    intensity = luminance * (ILLUMINATION_MEAN * 4 * pi / (luminance @ solid))
    facing = np.maximum(texels(16, 32)[0] @ towards.T, 0.0)
    brightest = (facing @ (chroma * (intensity * solid)[:, None]) / pi).max()
    return chroma, intensity, WHITE / float(brightest)


def lobes(coefficients: Doubles, theta_d: Doubles) -> tuple[Doubles, Doubles]:
    """log κ and log γ [D] of coefficients [2, 6], natural logarithms, at θ_d [D]."""
    t = theta_d / (pi / 2)
    bernstein = np.stack([comb(5, i) * t**i * (1 - t) ** (5 - i) for i in range(6)], axis=1)
    return bernstein @ coefficients[0], bernstein @ coefficients[1]


def linear(
    normals: Doubles,
    material: Doubles,
    intensity: Doubles,
    radiance: Doubles,
    back: Doubles,
    base_color: Doubles,
    preset: str = "matte",
) -> Doubles:
    """Linear image values [P, 3], +inf where a lobe overflows.

    normals [P, 3] and `back` [3] (towards the viewer), unit, world space; material [3, 3, 2, 6] and intensity,
    [rows, cols] or by channel [rows, cols, 3], in the units of the renderer's groups; radiance [rows, cols, 3] the
    unperturbed map; base_color [P, 3]; `preset` the material's name before it was perturbed.
    """
    towards, solid = texels(*radiance.shape[:2])
    chroma, _, exposure = taken_apart(radiance)
    power = exposure * chroma * intensity.reshape(len(solid), -1) * solid[:, None]
    total = towards + back
    length = np.linalg.norm(total, axis=1)
    half = np.where(length[:, None] > 1e-7, total / np.maximum(length, 1e-300)[:, None], 0.0)
    theta_d = np.where(length > 1e-7, np.arccos(np.clip((half * towards).sum(1), -1, 1)), pi / 2)
    cosine = normals @ towards.T
    log_half = np.log(np.maximum(normals @ half.T, COSINE_FLOOR))
    out = np.zeros((len(normals), 3))
    with np.errstate(over="ignore"):
        for channel in range(3):
            weight = np.maximum(cosine, 0.0) * power[:, channel]
            for number, lobe in enumerate(material[channel] / MATERIAL_UNIT):
                log_kappa, log_gamma = lobes(lobe, theta_d)
                rho = np.expm1(np.exp(log_kappa + np.exp(log_gamma) * log_half))
                # Without light or beyond the horizon an infinite lobe reflects nothing.
                sent = (np.where(weight > 0, rho, 0.0) * weight).sum(axis=1)
                color = 1.0 if number in UNCOLORED.get(preset, ()) else base_color[:, channel]
                out[:, channel] += np.where(color > 0, sent, 0.0) * color
    return out


def displayed(values: Doubles) -> Doubles:
    """The sRGB curve on [0,1] (IEC 61966-2-1)."""
    clipped = np.clip(values, 0.0, 1.0)
    curved: Doubles = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return curved


def vectors(angles: Doubles, view: Doubles) -> Doubles:
    """Unit normals [P, 3] in world space of azimuth and polar angle [P, 2] in the frame of the camera `view` [4, 4]."""
    azimuth, polar = angles[:, :1], angles[:, 1:]
    right, up, back = view[:3, 0], view[:3, 1], view[:3, 2]
    return np.sin(polar) * np.sin(azimuth) * right + np.cos(polar) * up + np.sin(polar) * np.cos(azimuth) * back
