"""Paint by its definition: scipy's cubic B-splines in the object's frame, and a share of the printable ends."""

import numpy as np

from tests.unit.rendering.dents import PLACES, SPLINE, at_places

DARKEST, LIGHTEST = 0.03, 0.87


def amounts(points: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Covered shares [P, 3] at points [P, 3] in the object's frame, of coefficients [NODES, NODES, NODES, 3]."""
    x, y, z = (at_places(SPLINE, points[:, k]) for k in range(3))
    return np.einsum("px,py,pz,xyzc->pc", x, y, z, coefficients, optimize=True)


def painted(points: np.ndarray, own: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Base colours [P, 3] of surfaces whose own are `own`."""
    share = amounts(points, coefficients)
    return np.where(share > 0, (1 - share) * own + share * LIGHTEST, (1 + share) * own - share * DARKEST)


def random_paint(objects: int = 1, seed: int = 0, largest: float = 1.0) -> np.ndarray:
    """Coefficients [objects, NODES, NODES, NODES, 3], each ± `largest`, which are the roughest that there are."""
    count = len(PLACES)
    return largest * np.random.default_rng(seed).choice([-1.0, 1.0], (objects, count, count, count, 3))
