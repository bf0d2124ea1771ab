"""Fits the material presets: the DSBRDF coefficients that are nearest to analytic reference BRDFs.

    python scripts/fit_materials.py                writes services/scene_attack/rendering/torch/presets.json
    python scripts/fit_materials.py --help         what can be set

The references and how they are brought to (θ_h, θ_d) are described in docs/reports/materials.md.
"""

import argparse
import json
import platform
import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy
import torch
from scipy.optimize import OptimizeResult, least_squares
from torch import Tensor

from scene_attack.rendering.torch import dsbrdf

ROOT = Path(__file__).resolve().parents[1]
THETA_H, THETA_D, PHI_D = 72, 24, 128
"""Samples of the half angle (denser towards 0), the difference angle and the angle that is averaged away."""
LARGEST_THETA_D = np.radians(85.0)
FLOOR = 0.03
"""Errors are of log(ρ + FLOOR): relative where a surface reflects, absolute where it is dark (white has ρ = 0.32)."""
STARTS = 6
INCIDENCES = np.radians([0, 30, 45, 55, 65, 72, 78, 80, 82, 83, 84, 85, 87, 88.5, 89.5, 89.99])
"""Angles at which light falls in where the reflected share is held to at most LARGEST_ALBEDO."""
LARGEST_ALBEDO = 1 - 2e-5
"""Just below 1, so that a finer quadrature than the fit's finds no more than 1."""
PENALTY = 300.0
"""Weight of a reflected share above LARGEST_ALBEDO, beside residuals whose weights are at most 1."""
COSINES = 512
"""Samples of the cosine in the table of the surface's directional albedo."""


@dataclass(frozen=True)
class HalfVectors:
    """Quadrature over half vectors for one direction of incidence: `theta_h`, `theta_d` [N], and `weight` [N], which is
    n·o times the solid angle of the outgoing direction o. Outgoing directions below the surface are left out."""

    theta_h: np.ndarray
    theta_d: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, incidence: float, rows: int = 96, columns: int = 32) -> "HalfVectors":
        """For light at `incidence` radians from the normal. Rows are denser towards θ_h = 0, where gloss is narrow."""
        t = (np.arange(rows) + 0.5) / rows
        theta, phi = np.meshgrid(np.pi / 2 * t**2, (np.arange(columns) + 0.5) * np.pi / columns, indexing="ij")
        area = (np.pi * t / rows)[:, None] * np.sin(theta) * 2 * np.pi / columns
        cos_d = np.sin(incidence) * np.sin(theta) * np.cos(phi) + np.cos(incidence) * np.cos(theta)
        n_o = 2 * cos_d * np.cos(theta) - np.cos(incidence)
        seen = (cos_d > 0) & (n_o > 0)
        weight = 4 * cos_d * n_o * area  # dω_o = 4 (o·h) dω_h
        weight = weight[seen] * (np.pi / weight[seen].sum())  # their sum is known: a white diffuse surface's
        return cls(theta[seen], np.arccos(np.minimum(cos_d[seen], 1.0)), weight)


@dataclass(frozen=True)
class Reference:
    """A diffuse base under a GGX surface (Walter et al. 2007), Schlick's Fresnel term, white base colour.

    The base reflects what the surface neither reflects on the way in nor on the way out (Kelemen and Szirmay-Kalos
    2001): with E(θ) the share that the surface reflects and Ē its mean over directions, the base's BRDF is
    albedo/π · (1 − E(θ_i)) (1 − E(θ_o)) / (1 − Ē), so that base and surface together reflect E + albedo · (1 − E) ≤ 1.
    """

    description: str
    base_lobes: int
    """Lobes that are fitted to the base alone."""
    gloss_lobes: int
    """Lobes that are fitted to the surface alone."""
    colored_gloss: bool = True
    """Whether the mesh's colour multiplies what the surface reflects, as for a conductor; not for a dielectric."""
    albedo: float = 0.0
    specular: float = 0.0
    alpha: float = 1.0

    def brdf(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The BRDFs of base and surface, 1/steradian [2, …], and (n·i)(n·o), 0 where one of the two is under the
        surface."""
        across = np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
        along = np.cos(theta_h) * np.cos(theta_d)
        n_i, n_o = along - across, along + across
        seen = (n_i > 0) & (n_o > 0)
        n_i, n_o = np.where(seen, n_i, 1.0), np.where(seen, n_o, 1.0)
        base = np.full(np.broadcast(n_i, theta_d).shape, self.albedo / np.pi)
        gloss = np.zeros_like(base)
        if self.specular:
            cosines, share, mean = self.surface_albedo
            lets_in, lets_out = (1 - np.interp(n, cosines, share) for n in (n_i, n_o))
            base = base * lets_in * lets_out / (1 - mean)
            gloss = self.gloss(theta_h, theta_d, n_i, n_o)
        return np.stack([base, gloss]), np.where(seen, n_i * n_o, 0.0)

    def gloss(self, theta_h: np.ndarray, theta_d: np.ndarray, n_i: np.ndarray, n_o: np.ndarray) -> np.ndarray:
        """The surface's part of the BRDF, with Smith's height-correlated shadowing."""
        fresnel = self.specular + (1 - self.specular) * (1 - np.cos(theta_d)) ** 5
        a2 = self.alpha**2
        facets = a2 / (np.pi * (np.cos(theta_h) ** 2 * (a2 - 1) + 1) ** 2)
        visible = 0.5 / (n_o * np.sqrt(a2 + (1 - a2) * n_i**2) + n_i * np.sqrt(a2 + (1 - a2) * n_o**2))
        return facets * visible * fresnel

    @cached_property
    def surface_albedo(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Cosines of incidence, the share of light that the surface reflects at each, and its mean Ē."""
        cosines = (np.arange(COSINES) + 0.5) / COSINES
        share = np.empty(COSINES)
        for index, n_i in enumerate(cosines):
            at = HalfVectors.of(np.arccos(n_i))
            n_o = 2 * np.cos(at.theta_d) * np.cos(at.theta_h) - n_i
            share[index] = (self.gloss(at.theta_h, at.theta_d, n_i, n_o) * at.weight).sum()
        return cosines, share, float((2 * cosines * share).mean())

    def mean(self, theta_h: np.ndarray, theta_d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The BRDFs of base and surface on the grid theta_h × theta_d [2, …], averaged over φ_d with weight (n·i)(n·o),
        and that weight's mean.

        The weight is how much a configuration counts in an image: light arrives by n·i, area is seen by n·o.
        Both are even about φ_d = 0 and π/2, so the angles up to π/2 at which light and viewer are above the surface do.
        """
        h, d = theta_h[:, None, None], theta_d[None, :, None]
        first = np.arccos(np.minimum(1.0, 1.0 / (np.tan(h) * np.tan(d))))
        phi = first + (np.pi / 2 - first) * (np.arange(PHI_D) + 0.5) / PHI_D
        value, weight = self.brdf(h, d, phi)
        mean_weight = weight.mean(-1) * (1 - first[..., 0] / (np.pi / 2))
        return (value * weight).sum(-1) / weight.sum(-1), mean_weight


REFERENCES = {
    "matte": Reference("Lambertian, albedo 1", 1, 0, albedo=1.0),
    "plastic": Reference(
        "Lambertian, albedo 0.95, under a GGX dielectric of index 1.5, α 0.3", 1, 2, False, 0.95, 0.04, 0.3
    ),
    "glossy-paint": Reference(
        "Lambertian, albedo 0.95, under a GGX dielectric of index 1.5, α 0.12", 1, 2, False, 0.95, 0.04, 0.12
    ),
    "brushed-metal": Reference("GGX conductor, reflectance 0.92 (aluminium), α 0.3", 0, 3, True, 0.0, 0.92, 0.3),
    "rubber": Reference(
        "Lambertian, albedo 0.95, under a GGX dielectric of index 1.5, α 0.49", 1, 2, False, 0.95, 0.04, 0.49
    ),
    "metal": Reference("GGX conductor, reflectance 1 (the base colour), α 0.16", 0, 3, True, 0.0, 1.0, 0.16),
}


class Points:
    """Pairs of angles [N] at which materials are evaluated, in float64, by the code that renders."""

    def __init__(self, theta_h: np.ndarray, theta_d: np.ndarray) -> None:
        self._curves = dsbrdf.basis(torch.from_numpy(theta_d))
        self._log_cosine = torch.from_numpy(np.log(np.maximum(np.cos(theta_h), dsbrdf.COSINE_FLOOR)))

    def brdf(self, coefficients: Tensor) -> Tensor:
        """ρ [N] of one channel's coefficients [lobes, 2, 6]."""
        log_kappa, gamma = dsbrdf.lobes(coefficients, self._curves)
        return dsbrdf.reflectance(self._log_cosine, log_kappa, gamma).sum(0)


class Furnace:
    """The share of light that a material reflects, for light that falls in at each of `incidences` (radians)."""

    def __init__(self, incidences: np.ndarray) -> None:
        parts = [HalfVectors.of(incidence) for incidence in incidences]
        self._points = Points(*(np.concatenate([getattr(p, a) for p in parts]) for a in ("theta_h", "theta_d")))
        self._weights = torch.from_numpy(np.concatenate([part.weight for part in parts]))
        self._which = torch.from_numpy(np.repeat(np.arange(len(parts)), [len(part.weight) for part in parts]))
        self._count = len(parts)

    def albedo(self, coefficients: Tensor) -> Tensor:
        """The reflected shares [incidences] of one channel's coefficients [lobes, 2, 6]."""
        values = self._points.brdf(coefficients) * self._weights
        return torch.zeros(self._count, dtype=values.dtype).index_add(0, self._which, values)


def fit(reference: Reference, seed: int) -> dict[str, object]:
    """Nonlinear least squares from several random starts. If the best makes light, it is fitted on with a penalty."""
    theta_h = (np.pi / 2 - 1e-3) * ((np.arange(THETA_H) + 0.5) / THETA_H) ** 2
    theta_d = LARGEST_THETA_D * (np.arange(THETA_D) + 0.5) / THETA_D
    parts, weight = reference.mean(theta_h, theta_d)
    targets, weight = torch.from_numpy(parts.reshape(2, -1)), torch.from_numpy(weight.ravel())
    target = targets.sum(0)
    points = Points(*(grid.ravel() for grid in np.meshgrid(theta_h, theta_d, indexing="ij")))
    furnace = Furnace(INCIDENCES)
    counts = [reference.base_lobes, reference.gloss_lobes]
    shape = (sum(counts), 2, dsbrdf.DEGREE + 1)

    def distance(flat: Tensor) -> Tensor:
        """Of each part that has lobes, and of their sum where both have."""
        lobes = torch.split(flat.reshape(shape), counts)
        pairs = [(points.brdf(own), of) for own, of in zip(lobes, targets, strict=True) if len(own)]
        if len(pairs) == 2:
            pairs.append((pairs[0][0] + pairs[1][0], target))
        return torch.cat([weight.sqrt() * ((rho + FLOOR).log() - (of + FLOOR).log()) for rho, of in pairs])

    def penalised(flat: Tensor) -> Tensor:
        excess = (furnace.albedo(flat.reshape(shape)) - LARGEST_ALBEDO).clamp_min(0.0)
        return torch.cat([distance(flat), PENALTY * excess])

    rng = np.random.default_rng(seed)
    starts = []
    for _ in range(STARTS):
        # Lobes of every width, each constant in θ_d to begin with.
        start = np.empty(shape)
        start[:, 0] = rng.uniform(-3, 1.5, (len(start), 1))
        start[:, 1] = np.sort(rng.uniform(-6, 6, len(start)))[:, None]
        starts.append(_least_squares(distance, start.ravel(), shape))
    best = min(starts, key=lambda found: float(found.cost))
    if furnace.albedo(torch.from_numpy(best.x).reshape(shape)).max() > LARGEST_ALBEDO:
        best = _least_squares(penalised, best.x, shape)
    coefficients = np.empty((dsbrdf.LOBES, 2, dsbrdf.DEGREE + 1))
    coefficients[:, 0], coefficients[:, 1] = dsbrdf.LOG_KAPPA_RANGE[0], 0.0
    coefficients[: sum(counts)] = best.x.reshape(shape).round(6)
    fitted = torch.from_numpy(coefficients)
    relative = ((points.brdf(fitted) - target).abs() / (target + FLOOR)).numpy()
    grid = relative.reshape(THETA_H, THETA_D)
    albedo = furnace.albedo(fitted)
    return {
        "reference": reference.description,
        "rms_relative_error": float(np.sqrt(np.average(relative**2, weights=weight.numpy()))),
        "max_relative_error": float(relative.max()),
        "max_at_theta_h_theta_d_degrees": [
            float(np.degrees(angle[i]))
            for angle, i in zip((theta_h, theta_d), np.unravel_index(grid.argmax(), grid.shape), strict=True)
        ],
        "largest_reference_value": float(target.max()),
        "largest_albedo": float(albedo.max()),
        "largest_albedo_at_degrees": float(np.degrees(INCIDENCES[int(albedo.argmax())])),
        "colored_lobes": [lobe < counts[0] or reference.colored_gloss for lobe in range(dsbrdf.LOBES)],
        "coefficients": np.broadcast_to(coefficients, dsbrdf.SHAPE).tolist(),
    }


def _least_squares(residual: Callable[[Tensor], Tensor], start: np.ndarray, shape: tuple[int, ...]) -> OptimizeResult:
    """The minimum near `start`, within the model's bounds, with the residual's exact Jacobian."""
    low, high = (
        np.broadcast_to(np.array([k, g])[:, None], shape).ravel()
        for k, g in zip(dsbrdf.LOG_KAPPA_RANGE, dsbrdf.LOG_GAMMA_RANGE, strict=True)
    )
    jacobian = torch.func.jacfwd(residual)
    return least_squares(
        lambda flat: residual(torch.from_numpy(flat)).numpy(),
        start.clip(low + 1e-9, high - 1e-9),
        jac=lambda flat: jacobian(torch.from_numpy(flat)).numpy(),
        bounds=(low, high),
        max_nfev=300,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "services" / "scene_attack" / "rendering" / "torch" / "presets.json",
        help="file to write",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the random starts")
    parser.add_argument("--only", choices=REFERENCES, help="fit one preset and print its errors; writes nothing")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    fits = {}
    for name, reference in REFERENCES.items():
        if arguments.only in (None, name):
            fits[name] = fit(reference, arguments.seed)
            print(name, {key: value for key, value in fits[name].items() if key != "coefficients"}, flush=True)
    if arguments.only:
        return
    report = {
        "command": shlex.join(["python", "scripts/fit_materials.py", *sys.argv[1:]]),
        "seed": arguments.seed,
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "torch": torch.__version__,
        },
        "error": f"|ρ_fit − ρ_reference| / (ρ_reference + {FLOOR}) over {THETA_H} × {THETA_D} samples of (θ_h, θ_d); "
        "the mean is weighted by (n·i)(n·o), the maximum is not",
        "albedo": "share of light reflected, largest over angles of incidence from 0° to 89.99°",
        "presets": fits,
    }
    arguments.out.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
