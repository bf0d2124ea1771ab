"""Fit the material presets: DSBRDF coefficients that come nearest to analytic reference BRDFs.

    python scripts/fit_materials.py                writes services/rendering/torch_renderer/presets.json
    python scripts/fit_materials.py --help         what can be set

The references and how they are brought to (θ_h, θ_d) are described in docs/materials.md.
"""

import argparse
import json
import platform
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
import torch
from scipy.optimize import least_squares

from services.rendering.torch_renderer import dsbrdf

ROOT = Path(__file__).resolve().parents[1]
THETA_H, THETA_D, PHI_D = 72, 24, 128
"""Samples of the half angle (denser towards 0), the difference angle and the angle that is averaged away."""
LARGEST_THETA_D = np.radians(85.0)
FLOOR = 0.03
"""Errors are of log(ρ + FLOOR): relative where a surface reflects, absolute where it is dark (white has ρ = 0.32)."""
STARTS = 6


@dataclass(frozen=True)
class Reference:
    """A diffuse base under a GGX surface (Walter et al. 2007), Schlick's Fresnel term, white base colour."""

    description: str
    lobes: int
    albedo: float = 0.0
    specular: float = 0.0
    alpha: float = 1.0

    def brdf(self, theta_h: np.ndarray, theta_d: np.ndarray, phi_d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The BRDF, 1/steradian, and (n·i)(n·o), 0 where one of the two is under the surface."""
        across = np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
        along = np.cos(theta_h) * np.cos(theta_d)
        n_i, n_o = along - across, along + across
        seen = (n_i > 0) & (n_o > 0)
        n_i, n_o = np.where(seen, n_i, 1.0), np.where(seen, n_o, 1.0)
        fresnel = 0.0
        value = np.full(np.broadcast(n_i, theta_d).shape, self.albedo / np.pi)
        if self.specular:
            fresnel = self.specular + (1 - self.specular) * (1 - np.cos(theta_d)) ** 5
            a2 = self.alpha**2
            facets = a2 / (np.pi * (np.cos(theta_h) ** 2 * (a2 - 1) + 1) ** 2)
            visible = 0.5 / (n_o * np.sqrt(a2 + (1 - a2) * n_i**2) + n_i * np.sqrt(a2 + (1 - a2) * n_o**2))
            value = value * (1 - fresnel) + facets * visible * fresnel
        return value, np.where(seen, n_i * n_o, 0.0)

    def mean(self, theta_h: np.ndarray, theta_d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The BRDF on the grid theta_h × theta_d, averaged over φ_d with weight (n·i)(n·o), and its mean.

        The weight is how much a configuration counts in a picture: light arrives by n·i, area is seen by n·o.
        Both are even about φ_d = 0 and π/2, so the angles up to π/2 at which light and viewer are above the surface do.
        """
        h, d = theta_h[:, None, None], theta_d[None, :, None]
        first = np.arccos(np.minimum(1.0, 1.0 / (np.tan(h) * np.tan(d))))
        phi = first + (np.pi / 2 - first) * (np.arange(PHI_D) + 0.5) / PHI_D
        value, weight = self.brdf(h, d, phi)
        mean_weight = weight.mean(-1) * (1 - first[..., 0] / (np.pi / 2))
        return (value * weight).sum(-1) / weight.sum(-1), mean_weight


REFERENCES = {
    "matte": Reference("Lambertian, albedo 1", 1, albedo=1.0),
    "plastic": Reference("Lambertian, albedo 0.95, under a GGX dielectric of index 1.5, α 0.3", 3, 0.95, 0.04, 0.3),
    "glossy-paint": Reference(
        "Lambertian, albedo 0.95, under a GGX dielectric of index 1.5, α 0.12", 3, 0.95, 0.04, 0.12
    ),
    "brushed-metal": Reference("GGX conductor, reflectance 0.92 (aluminium), α 0.3", 3, 0.0, 0.92, 0.3),
}


def evaluate(coefficients: np.ndarray, curves: np.ndarray, log_cosine: np.ndarray) -> np.ndarray:
    """ρ [H, D] of one channel's coefficients [lobes, 2, 6], in float64, by the code that renders."""
    log_kappa, gamma = dsbrdf.lobes(torch.from_numpy(coefficients), torch.from_numpy(curves))
    lobes = dsbrdf.reflectance(torch.from_numpy(log_cosine)[:, None, None], log_kappa, gamma)
    return lobes.sum(1).numpy()


def fit(reference: Reference, seed: int) -> dict[str, object]:
    """Nonlinear least squares from several random starts; the best, with its errors."""
    theta_h = (np.pi / 2 - 1e-3) * ((np.arange(THETA_H) + 0.5) / THETA_H) ** 2
    theta_d = LARGEST_THETA_D * (np.arange(THETA_D) + 0.5) / THETA_D
    target, weight = reference.mean(theta_h, theta_d)
    curves = dsbrdf.basis(torch.from_numpy(theta_d)).numpy()
    log_cosine = np.log(np.cos(theta_h))
    shape = (reference.lobes, 2, dsbrdf.DEGREE + 1)
    low, high = (
        np.broadcast_to(np.array([k, g])[:, None], shape).ravel()
        for k, g in zip(dsbrdf.LOG_KAPPA_RANGE, dsbrdf.LOG_GAMMA_RANGE, strict=True)
    )

    def residual(flat: np.ndarray) -> np.ndarray:
        rho = evaluate(flat.reshape(shape), curves, log_cosine)
        return (np.sqrt(weight) * (np.log(rho + FLOOR) - np.log(target + FLOOR))).ravel()

    rng = np.random.default_rng(seed)
    best = None
    for _ in range(STARTS):
        # Lobes of every width, each constant in θ_d to begin with.
        start = np.empty(shape)
        start[:, 0] = rng.uniform(-3, 1.5, (reference.lobes, 1))
        start[:, 1] = np.sort(rng.uniform(-6, 6, reference.lobes))[:, None]
        found = least_squares(residual, start.ravel(), bounds=(low, high), max_nfev=300)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    coefficients = np.empty((dsbrdf.LOBES, 2, dsbrdf.DEGREE + 1))
    coefficients[:, 0], coefficients[:, 1] = dsbrdf.LOG_KAPPA_RANGE[0], 0.0
    coefficients[: reference.lobes] = best.x.reshape(shape).round(6)
    error = evaluate(coefficients, curves, log_cosine) - target
    relative = np.abs(error) / (target + FLOOR)
    return {
        "reference": reference.description,
        "rms_relative_error": float(np.sqrt(np.average(relative**2, weights=weight))),
        "max_relative_error": float(relative.max()),
        "max_at_theta_h_theta_d_degrees": [
            float(np.degrees(angle[i]))
            for angle, i in zip((theta_h, theta_d), np.unravel_index(relative.argmax(), relative.shape), strict=True)
        ],
        "largest_reference_value": float(target.max()),
        "coefficients": np.broadcast_to(coefficients, dsbrdf.SHAPE).tolist(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out",
        type=Path,
        default=ROOT / "services" / "rendering" / "torch_renderer" / "presets.json",
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
        "presets": fits,
    }
    arguments.out.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
