"""A lattice in each object's own frame, whose nodes cubic B-splines join to a solid function of the place. So it is of
the object, not of the image, and the same from every view.

The function is a sum of tensor products of cubic B-splines (Unser 1999, eq. 4). It needs no map of the surface and no
mesh without holes, it is twice continuously differentiable, never beyond its largest coefficient, and it has nearly
nothing of waves shorter than two cells along an axis, and little of those down to 1.2 cells that run diagonally. The
size of an object is the diameter of its bounding sphere.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import floor
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from scene_attack.rendering.opengl.gbuffer import Fragments
from scene_attack.rendering.torch.surfaces import camera_rays
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import ResolvedScene

CHUNK = 16_384
"""Surfaces whose 64 nodes each are held at a time: 25 MB in float64."""
PER_CELL = 2
"""Places along each edge of a cell at which slopes are limited: its node and its middle, where steep waves are
steepest. Between them slopes are up to 6 % larger, by linear programs over the coefficients; `shape.STEEPEST` says what
the norms of three gradients are."""


@dataclass(frozen=True)
class Lattice:
    """The lattice of an object: `cells` along each edge of the cube around its bounding sphere."""

    cells: int

    @classmethod
    def of(cls, wavelength: float) -> "Lattice":
        """The finest one that has no shorter waves along an axis than `wavelength`, in sizes of the object."""
        return cls(floor(2 / wavelength + 1e-9))

    @classmethod
    def under(cls, coefficients: Tensor) -> "Lattice":
        """That of coefficients [objects, nodes, nodes, nodes, …]."""
        return cls(coefficients.shape[1] - 3)

    @property
    def nodes(self) -> int:
        """Nodes along each axis: those of the cube, and one more on each side but the last, where there are two, so
        that each point of it has four."""
        return self.cells + 3

    @property
    def spacing(self) -> float:
        """Distance of nodes, in scene units at scale 1."""
        return FIT_RADIUS * (2 / self.cells)

    def zeros(self, objects: int, *channels: int) -> Tensor:
        """Coefficients [objects, nodes, nodes, nodes, *channels] of 0."""
        return torch.zeros(objects, self.nodes, self.nodes, self.nodes, *channels)


@dataclass(frozen=True)
class Places:
    """Places of surfaces in the lattices of their objects.

    `lattice` is that of every object; `first` int64 [P], the flat index of the first of the 64 nodes around each, among
    those of all objects; `within` float64 [P, 3], in [0,1], the place in the cell; `is_object` bool [P], False for
    surfaces that are no object's, where every function is 0.
    """

    lattice: Lattice
    first: Tensor
    within: Tensor
    is_object: Tensor

    @classmethod
    def at(cls, lattice: Lattice, points: Tensor, index: Tensor, is_object: Tensor) -> "Places":
        """Those of points float64 [P, 3] in the frames of the objects `index` int64 [P] (see `own_points`)."""
        steps = ((points + FIT_RADIUS) / lattice.spacing).clamp(0.0, lattice.cells)
        cell = steps.floor().clamp_max(lattice.cells - 1.0)
        (x, y, z), nodes = cell.long().unbind(1), lattice.nodes
        return cls(lattice, ((index * nodes + x) * nodes + y) * nodes + z, steps - cell, is_object)

    @classmethod
    def on(cls, lattice: Lattice, points: Tensor, k: int) -> "Places":
        """Those of points float64 [P, 3] of object `k`, in its frame."""
        index = torch.full((len(points),), k, device=points.device)
        return cls.at(lattice, points, index, torch.ones_like(index, dtype=torch.bool))

    def values(self, coefficients: Tensor) -> Tensor:
        """Values [P, C] of the functions that have the coefficients [objects, nodes, nodes, nodes, C], on the places'
        device. They are differentiable (once)."""
        return self._sums(coefficients, _of_values)[:, 0]

    def gradients(self, coefficients: Tensor) -> Tensor:
        """Gradients [P, 3, C], by the axes of the objects' frames, of the functions that have the coefficients
        [objects, nodes, nodes, nodes, C], in their unit per scene unit at scale 1, on the places' device. They are
        differentiable (once)."""
        return self._sums(coefficients, _of_gradients) / self.lattice.spacing

    def _sums(self, coefficients: Tensor, weigh: "Weigh") -> Tensor:
        of_nodes = coefficients.to(self.first.device).flatten(0, 3)
        sums: Tensor = _Sums.apply(of_nodes, self, weigh)  # type: ignore[no-untyped-call]
        return sums

    def weighted(self, weigh: "Weigh", dtype: torch.dtype) -> Iterator[tuple[slice, Tensor, Tensor]]:
        """Yields some of the places, the flat indices [p, 64] of their nodes, and the nodes' weights [p, K, 64]."""
        steps, nodes = torch.arange(4, device=self.first.device), self.lattice.nodes
        around = ((steps[:, None, None] * nodes + steps[:, None]) * nodes + steps).flatten()
        for start in range(0, len(self.first), CHUNK):
            some = slice(start, start + CHUNK)
            weights = weigh(self.within[some].to(dtype)) * self.is_object[some, None, None]
            yield some, self.first[some, None] + around, weights


def own_points(scene: ResolvedScene, shown: Fragments, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Points of surfaces in the frames of their objects, float64 [P, 3], the objects' indices, int64 [P], and whether
    they are an object's, bool [P]; else both are 0."""
    is_object = shown.object_index < len(scene.description.objects)
    index = torch.where(is_object, shown.object_index.clamp_min(0), 0)
    world = torch.from_numpy(scene.eye + camera_rays(scene, shown) * shown.depth.cpu().numpy()[:, None]).to(device)
    points = torch.zeros_like(world)
    for k in range(len(scene.description.objects)):
        model = torch.as_tensor(scene.placed[k].model, dtype=torch.float64, device=device)
        own = shown.object_index == k
        points[own] = torch.linalg.solve(model[:3, :3], (world[own] - model[:3, 3]).T).T
    return points, index, is_object


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


def limited(coefficients: Tensor, steepest: float) -> Tensor:
    """Coefficients [objects, nodes, nodes, nodes, C] that are nowhere steeper than `steepest` (see `steepness`) but
    for what is between the places of `PER_CELL`. Where they would be, the nodes around are divided by the excess, and
    then all of the object's by what is left of it. It is differentiable where no two places are equally steep."""
    from_each = torch.nn.functional.pad(steepness(coefficients)[:, None] / steepest, (2 * PER_CELL,) * 6)
    around = torch.nn.functional.max_pool3d(from_each, 2 * PER_CELL + 1, stride=PER_CELL)[:, 0]  # as far as nodes go
    lower = coefficients / around.clamp_min(1.0)[..., None]
    excess = steepness(lower).amax((1, 2, 3)) / steepest
    return lower / excess.clamp_min(1.0)[:, None, None, None, None]


def steepness(coefficients: Tensor) -> Tensor:
    """Frobenius norms [objects, places, places, places] of the gradients of the functions that have the coefficients
    [objects, nodes, nodes, nodes, C], at `PER_CELL` places along each edge of the cells, in their unit per scene unit
    at scale 1."""
    values, slopes = _along_an_axis(coefficients)
    along = (slopes, values, values), (values, slopes, values), (values, values, slopes)
    gradient = torch.stack([torch.einsum("oijkv,ai,bj,ck->oabcv", coefficients, *of) for of in along])
    norms: Tensor = torch.linalg.vector_norm(gradient, dim=(0, -1))
    return norms / Lattice.under(coefficients).spacing


def _along_an_axis(like: Tensor) -> tuple[Tensor, Tensor]:
    """Weights [places, nodes] of the nodes along an axis, of the value and the slope, at `PER_CELL` places a cell."""
    lattice = Lattice.under(like)
    steps = torch.arange(lattice.cells * PER_CELL + 1, dtype=torch.float64) / PER_CELL
    first = steps.floor().clamp_max(lattice.cells - 1.0)
    nodes = first.long()[:, None] + torch.arange(4)
    empty = torch.zeros(len(steps), lattice.nodes, dtype=torch.float64)
    values, slopes = (empty.scatter(1, nodes, of[:, 0]).to(like) for of in splines((steps - first)[:, None]))
    return values, slopes
