"""A lattice in each object's own frame, whose nodes cubic B-splines join to a solid function of the place. So it is of
the object, not of the image, and the same from every view.

The function is a sum of tensor products of cubic B-splines (Unser 1999, eq. 4). It needs no map of the surface and no
mesh without holes, it is twice continuously differentiable, never beyond its largest coefficient, and it has nearly
nothing of wavelengths shorter than `WAVELENGTH`, as nodes are half of that apart. The size of an object is the diameter
of its bounding sphere.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from scene_attack.rendering.opengl.gbuffer import Fragments
from scene_attack.rendering.torch.surfaces import camera_rays
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene

WAVELENGTH = 0.1
"""Shortest wavelength of the function, in sizes of the object."""
NODES = round(2 / WAVELENGTH) + 3
"""Nodes of the lattice along each axis: those of a cube around the bounding sphere, and one more on each side but the
last, where there are two, so that each point of it has four."""
SPACING = FIT_RADIUS * WAVELENGTH
"""Distance of nodes, in scene units at scale 1."""
CHUNK = 16_384
"""Surfaces whose 64 nodes each are held at a time: 25 MB in float64."""


@dataclass(frozen=True)
class Places:
    """Places of surfaces in the lattices of their objects.

    `first` int64 [P], the flat index of the first of the 64 nodes around each, among those of all objects; `within`
    float64 [P, 3], in [0,1], the place in the cell; `is_object` bool [P], False for surfaces that are no object's,
    where every function is 0.
    """

    first: Tensor
    within: Tensor
    is_object: Tensor

    @classmethod
    def of(cls, scene: ResolvedScene, shown: Fragments, device: torch.device) -> "Places":
        """The places of the surfaces `shown`."""
        index = shown.object_index
        world = torch.from_numpy(scene.eye + camera_rays(scene, shown) * shown.depth.cpu().numpy()[:, None]).to(device)
        points = torch.zeros_like(world)
        for k in range(len(scene.description.objects)):
            model = torch.as_tensor(scene.placed[k].model, dtype=torch.float64, device=device)
            own = index == k
            points[own] = torch.linalg.solve(model[:3, :3], (world[own] - model[:3, 3]).T).T
        is_object = index < len(scene.description.objects)
        return cls.at(points, torch.where(is_object, index.clamp_min(0), 0), is_object)

    @classmethod
    def at(cls, points: Tensor, index: Tensor, is_object: Tensor) -> "Places":
        """Those of points float64 [P, 3] in the frames of the objects `index` int64 [P]."""
        steps = ((points + FIT_RADIUS) / SPACING).clamp(0.0, NODES - 3.0)
        cell = steps.floor().clamp_max(NODES - 4.0)
        x, y, z = cell.long().unbind(1)
        return cls(((index * NODES + x) * NODES + y) * NODES + z, steps - cell, is_object)

    def values(self, coefficients: Tensor) -> Tensor:
        """Values [P, C] of the functions that have the coefficients [objects, NODES, NODES, NODES, C]. They are
        differentiable (once)."""
        values: Tensor = _Sums.apply(coefficients.flatten(0, 3), self, _of_values)  # type: ignore[no-untyped-call]
        return values[:, 0]

    def gradients(self, coefficients: Tensor) -> Tensor:
        """Gradients [P, 3] in the objects' frames of the function that has the coefficients [objects, NODES, NODES,
        NODES], in their unit by `SPACING`. They are differentiable (once)."""
        flat = coefficients.reshape(-1, 1)
        gradients: Tensor = _Sums.apply(flat, self, _of_gradients)  # type: ignore[no-untyped-call]
        return gradients[..., 0]

    def weighted(self, weigh: "Weigh", dtype: torch.dtype) -> Iterator[tuple[slice, Tensor, Tensor]]:
        """Yields some of the places, the flat indices [p, 64] of their nodes, and the nodes' weights [p, K, 64]."""
        steps = torch.arange(4, device=self.first.device)
        around = ((steps[:, None, None] * NODES + steps[:, None]) * NODES + steps).flatten()
        for start in range(0, len(self.first), CHUNK):
            some = slice(start, start + CHUNK)
            weights = weigh(self.within[some].to(dtype)) * self.is_object[some, None, None]
            yield some, self.first[some, None] + around, weights


Weigh = Callable[[Tensor], Tensor]
"""From places [p, 3] within their cells to the weights [p, K, 64] of the nodes around them."""


class _Sums(torch.autograd.Function):
    """Sums [P, K, C] of coefficients [nodes, C] by weights. The derivative makes the weights again: they are large."""

    @staticmethod
    def forward(ctx: Any, coefficients: Tensor, places: Places, weigh: Weigh) -> Tensor:
        ctx.places, ctx.weigh, ctx.like = places, weigh, coefficients.detach()
        count = coefficients.shape[1]
        sums = [
            weights @ coefficients.index_select(0, nodes.flatten()).view(-1, 64, count)
            for _, nodes, weights in places.weighted(weigh, coefficients.dtype)
        ]
        return torch.cat(sums)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        result = torch.zeros_like(ctx.like)
        for some, nodes, weights in ctx.places.weighted(ctx.weigh, result.dtype):
            result.index_add_(0, nodes.flatten(), (weights.mT @ gradient[some]).flatten(0, 1))
        return result, None, None


def splines(within: Tensor) -> tuple[Tensor, Tensor]:
    """The four cubic B-splines that are not 0 at places [P, 3] within a cell, and their derivatives: each [P, 3, 4]."""
    t, s = within, 1 - within
    values = (s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3)
    derivatives = (-(s**2), 3 * t**2 - 4 * t, 4 * s - 3 * s**2, t**2)
    return torch.stack(values, dim=-1) / 6, torch.stack(derivatives, dim=-1) / 2


def _of_values(within: Tensor) -> Tensor:
    """The value [p, 1, 64] that a coefficient of 1 at each node gives."""
    return _product(*splines(within)[0].unbind(1))[:, None]


def _of_gradients(within: Tensor) -> Tensor:
    """The gradient [p, 3, 64] that it gives."""
    (x, y, z), (dx, dy, dz) = (of.unbind(1) for of in splines(within))
    return torch.stack((_product(dx, y, z), _product(x, dy, z), _product(x, y, dz)), dim=1)


def _product(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """The products [p, 64] of factors [p, 4] along each axis."""
    return (x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]).flatten(1)
