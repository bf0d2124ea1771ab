"""Paint: a pattern of base colour on the surface of each object. It is of the object, not of the image, so that one
painted object is the same from every view.

In each channel a share |a| of the surface is covered by the lightest (a > 0) or the darkest (a < 0) paint there is:

    color' = (1 − |a|) color + |a| (`PRINTABLE` lightest or darkest),

with a in [−1, 1] a solid function of the place in the object's own frame (scene_attack.rendering.torch.lattice), which
is as smooth as its waves are long. So every colour is the scene's own, or between it and what can be printed, and a
surface without paint keeps its own bits. At a = 0 the derivative by a jumps where the own colour is not the middle one;
the mean of both sides is taken, which is what a central difference finds.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from scene_attack.rendering.opengl.gbuffer import Fragments
from scene_attack.rendering.torch.lattice import Places

PRINTABLE = (0.03, 0.87)
"""Darkest and lightest linear reflectance of a channel. Offset printing on coated paper reaches L* = 16 in solid black,
a reflectance of 0.02, and the paper has L* = 95, 0.88 (ISO 12647-2:2013). Each channel is bounded by itself: the most
saturated blues and greens of this cube are beyond what four inks mix."""


@dataclass(frozen=True)
class Paint:
    """The surfaces that are `shown`, and their `places` in the lattice."""

    shown: Fragments
    places: Places

    def colors(self, own: Tensor, coefficients: Tensor) -> Tensor:
        """Returns linear base colours [P, 3] of surfaces whose own are `own`, painted by `coefficients` [objects,
        nodes, nodes, nodes, 3] in [−1, 1], of the same dtype. It is differentiable (once) in the coefficients."""
        amounts = self.places.values(coefficients)
        darkest, lightest = PRINTABLE
        middle, half = (lightest + darkest) / 2, (lightest - darkest) / 2
        return own + half * amounts + (middle - own) * amounts.abs()


TO_XYZ = torch.tensor(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]], dtype=torch.float64
)
"""From linear sRGB to CIE XYZ (IEC 61966-2-1)."""


def cielab(linear: Tensor) -> Tensor:
    """Returns L*, a*, b* [..., 3] (CIE 1976, white point D65) of linear sRGB colours [..., 3], float64."""
    ratios = (linear @ TO_XYZ.to(linear).T) / TO_XYZ.to(linear).sum(1)
    knee = 6 / 29
    x, y, z = torch.where(
        ratios > knee**3, ratios.clamp_min(knee**3) ** (1 / 3), ratios / (3 * knee**2) + 4 / 29
    ).unbind(-1)
    return torch.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), dim=-1)
