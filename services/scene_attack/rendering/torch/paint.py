"""Paint: a pattern of base colour on the surface of each object. It is of the object, not of the image, so that one
painted object is the same from every view.

In each channel a share |a| of the surface is covered by the lightest (a > 0) or the darkest (a < 0) paint there is:

    color' = (1 − |a|) color + |a| (`PRINTABLE` lightest or darkest),

with a in [−1, 1] a solid function of the place in the object's own frame (scene_attack.rendering.torch.lattice), which
is as smooth as its waves are long. So every colour is the scene's own, or between it and what can be printed, and a
surface without paint keeps its own bits. At a = 0 the derivative by a jumps where the own colour is not the middle one;
the mean of both sides is taken, which is what a central difference finds.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from scene_attack.rendering.opengl.gbuffer import Fragments
from scene_attack.rendering.torch.lattice import CHUNK, nodes, places, product, splines
from scene_attack.scenes.resolve import ResolvedScene

PRINTABLE = (0.03, 0.87)
"""Darkest and lightest linear reflectance of a channel. Offset printing on coated paper reaches L* = 16 in solid black,
a reflectance of 0.02, and the paper has L* = 95, 0.88 (ISO 12647-2:2013). Each channel is bounded by itself: the most
saturated blues and greens of this cube are beyond what four inks mix."""


@dataclass(frozen=True)
class Paint:
    """The surfaces that are `shown`, and their places in the lattice.

    `first` int64 [P] and `within` float64 [P, 3] are as `lattice.places` returns them; `is_object` [P] is False for
    surfaces that are no object's, which have no paint.
    """

    shown: Fragments
    first: Tensor
    within: Tensor
    is_object: Tensor

    @classmethod
    def of(cls, scene: ResolvedScene, shown: Fragments, device: torch.device) -> "Paint":
        """The places of the surfaces `shown`."""
        return cls(shown, *places(scene, shown, device), shown.object_index < len(scene.description.objects))

    def colors(self, own: Tensor, coefficients: Tensor) -> Tensor:
        """Returns linear base colours [P, 3] of surfaces whose own are `own`, painted by `coefficients` [objects,
        NODES, NODES, NODES, 3] in [−1, 1], of the same dtype. It is differentiable (once) in the coefficients."""
        amounts: Tensor = _Amounts.apply(coefficients, self)  # type: ignore[no-untyped-call]
        darkest, lightest = PRINTABLE
        middle, half = (lightest + darkest) / 2, (lightest - darkest) / 2
        return own + half * amounts + (middle - own) * amounts.abs()

    def amounts(self, coefficients: Tensor) -> Tensor:
        """The covered shares [P, 3] of the surfaces, with the sign of the paint."""
        flat, parts = coefficients.reshape(-1, 3), []
        for first, weights in self._chunks(coefficients.dtype):
            values = flat.index_select(0, nodes(first, flat.device).flatten()).view(-1, 64, 3)
            parts.append((weights[:, None] @ values)[:, 0])
        return torch.cat(parts)

    def pulled(self, gradient: Tensor, like: Tensor) -> Tensor:
        """The transpose of `amounts`: from a gradient by shares [P, 3] that by coefficients, of the shape of `like`."""
        result, start = torch.zeros_like(like).view(-1, 3), 0
        for first, weights in self._chunks(like.dtype):
            own = gradient[start : start + len(first)]
            result.index_add_(0, nodes(first, like.device).flatten(), (weights[..., None] * own[:, None]).view(-1, 3))
            start += len(first)
        return result.view_as(like)

    def _chunks(self, dtype: torch.dtype) -> Iterator[tuple[Tensor, Tensor]]:
        """Yields the first nodes of some surfaces, and the weights of their 64 nodes."""
        for start in range(0, len(self.first), CHUNK):
            some = slice(start, start + CHUNK)
            values = splines(self.within[some].to(dtype))[0]
            yield self.first[some], product(*values.unbind(1)) * self.is_object[some, None]


class _Amounts(torch.autograd.Function):
    """`Paint.amounts`, a linear function, with its transpose as derivative: its weights are made again, not kept."""

    @staticmethod
    def forward(ctx: Any, coefficients: Tensor, paint: Paint) -> Tensor:
        ctx.paint, ctx.like = paint, coefficients.detach()
        return paint.amounts(coefficients)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        return ctx.paint.pulled(gradient, ctx.like), None


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
