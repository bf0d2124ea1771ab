"""Dents by their definition: tensor products of scipy's cubic B-splines, independently of the renderer's."""

import numpy as np
from scipy.interpolate import BSpline

from scene_attack.rendering.torch.bump import UNIT
from scene_attack.rendering.torch.lattice import Lattice
from scene_attack.scenes.mesh import FIT_RADIUS

NODES, SPACING = Lattice.of(0.1).nodes, Lattice.of(0.1).spacing
SPLINE = BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)
SLOPE = SPLINE.derivative()
PLACES = (np.arange(NODES) - 1) * SPACING - FIT_RADIUS
"""Of the nodes along each axis, in the object's frame."""


def height(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Heights [P], scene units, of an object at scale 1 at points [P, 3] in its frame."""
    x, y, z = (at_places(SPLINE, points[:, k]) for k in range(3))
    return UNIT * _sums(x, y, z, coefficients)


def gradient(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Its gradients [P, 3]."""
    values = [at_places(SPLINE, points[:, k]) for k in range(3)]
    slopes = [at_places(SLOPE, points[:, k]) / SPACING for k in range(3)]
    along = [[slopes[k] if k == axis else values[k] for k in range(3)] for axis in range(3)]
    return UNIT * np.stack([_sums(*of, coefficients) for of in along], axis=1)


def _sums(x: np.ndarray, y: np.ndarray, z: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Σ x[p,i] y[p,j] z[p,k] coefficients[i,j,k], for 4,096 points at a time."""
    flat, sums = coefficients.reshape(NODES**2, NODES), np.empty(len(x))
    for start in range(0, len(x), 4096):
        some = slice(start, start + 4096)
        along_z = (z[some] @ flat.T).reshape(-1, NODES, NODES)
        sums[some] = np.einsum("pi,pij,pj->p", x[some], along_z, y[some], optimize=True)
    return sums


def at_places(spline: BSpline, places: np.ndarray) -> np.ndarray:
    """Values [P, NODES] at places [P] along an axis of the splines around each node."""
    return np.nan_to_num(spline((places[:, None] - PLACES) / SPACING))


def random_dents(objects: int = 1, seed: int = 0, largest: float = 10.0) -> np.ndarray:
    """Coefficients [objects, NODES, NODES, NODES], each ± `largest`, which are the roughest that there are."""
    rng = np.random.default_rng(seed)
    return largest * rng.choice([-1.0, 1.0], (objects, NODES, NODES, NODES))
