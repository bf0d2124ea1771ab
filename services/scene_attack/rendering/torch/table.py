"""Unit normals as the paper's two angles per pixel, tables of radiance over them, and the check of a table in each
image.

The angles are of the camera's frame: polar angle θ from the camera's up axis (+y), azimuth φ about it from the axis
towards the viewer (+z) to the camera's right (+x), so n = (sin θ sin φ, cos θ, sin θ cos φ). A visible surface has n·z
> 0, hence φ in (−π/2, π/2), away from the jump at ±π; and the pole, where φ has no meaning, lies on the silhouette:
only surfaces seen exactly edge-on have a normal straight up. The pole is harmless: n is smooth in (θ, φ) everywhere and
its gradient with respect to φ goes to zero at the pole.

Row i of a table is at polar angle (i + ½)h, column j at azimuth −π + (j + ½)h, h = π / rows, with twice as many columns
as rows. A normal is smooth and periodic in its angles, so a table needs no border: beyond a pole the rows repeat in
reverse order, shifted by half a turn of azimuth. Values between nodes are interpolated by Catmull-Rom splines in both
angles, which are once continuously differentiable.

No bound of a table's error is known that is cheap and tight: an attack takes normals, light and material to where the
table was not measured. So the error is sampled, in every image, where it is likely to be largest: a third of the pixels
have the largest fourth differences of the table around their normal, a third the largest second differences, both times
the steepness of the display's curve; the last third are spread evenly over the object, from a start that changes with
the image. The choice depends on the image alone, so that an attack that is resumed chooses the same pixels.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import isqrt, pi
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from scene_attack.rendering.color import KNEE
from scene_attack.rendering.kernels import compiled

MAX_ANGLE = 100.0
"""Largest magnitude of an attacked angle, radians: 16 turns, more than 120 steps of the paper's size can reach. There
float32 resolves 8e-6 radians. At 1e6 it would resolve 0.06, and the float32 attack loop and the float64 verifier would
see different normals."""


def to_angles(vectors: Tensor) -> Tensor:
    """Returns azimuth and polar angle [..., 2], radians, of vectors [..., 3] in the camera's frame (of any length > 0).

    The azimuth is in [−π, π], and 0 at the poles; the polar angle is in [0, π]. The zero vector gives (0, 0).
    """
    x, y, z = vectors.unbind(-1)
    horizontal = torch.hypot(x, z)
    azimuth = torch.where(horizontal > 0, torch.atan2(x, z), 0.0)
    return torch.stack((azimuth, torch.atan2(horizontal, y)), dim=-1)


def to_vectors(angles: Tensor) -> Tensor:
    """Returns unit vectors [..., 3] in the camera's frame for azimuth and polar angle [..., 2], radians.

    The angles may have any finite values. It is differentiable; only once in float32 on the CPU, where a
    compiled kernel runs.
    """
    if angles.dtype == torch.float32 and compiled.runs(angles):
        result: Tensor = _Vectors.apply(angles.contiguous())  # type: ignore[no-untyped-call]
        return result
    azimuth, polar = angles.unbind(-1)
    horizontal = polar.sin()
    return torch.stack((horizontal * azimuth.sin(), polar.cos(), horizontal * azimuth.cos()), dim=-1)


class _Vectors(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, angles: Tensor) -> Tensor:
        ctx.save_for_backward(angles)
        vectors = angles.new_empty(*angles.shape[:-1], 3)
        compiled.call("vectors", angles.dtype, angles.numel() // 2, angles, vectors, compiled.threads())
        return vectors

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        [angles] = ctx.saved_tensors
        result = torch.empty_like(angles)
        arguments = (angles.numel() // 2, angles, gradient.contiguous(), result)
        compiled.call("vectors_backward", angles.dtype, *arguments, compiled.threads())
        return result


CPU = torch.device("cpu")
TILE = 4
"""Side of a tile in nodes. Tables are filled tile by tile, as neighbouring normals see nearly the same directions."""


def look_up(table: Tensor, angles: Tensor) -> Tensor:
    """Interpolates a table [rows · 2 rows, 3] at azimuth and polar angle [P, 2], radians; returns values [P, 3].

    The angles may have any finite values. It is differentiable (once) in the table and in the angles.
    """
    if compiled.runs(angles):
        result: Tensor = _LookUp.apply(table, angles.contiguous())  # type: ignore[no-untyped-call]
        return result
    nodes, weights = _interpolation_weights(angles, _rows(table))
    return (table[nodes] * weights[..., None]).sum(1)


def touched(angles: Tensor, rows: int) -> Tensor:
    """Marks the tiles on which the values at `angles` [P, 2] depend: bool [tiles of the table]."""
    if compiled.runs(angles):
        marked, plain = torch.zeros(len(tiles(rows)), dtype=torch.bool), angles.detach().contiguous()
        compiled.call("touch", angles.dtype, len(plain), rows, plain, marked, compiled.threads())
        return marked
    nodes = torch.zeros(2 * rows * rows, dtype=torch.bool, device=angles.device)
    nodes[_interpolation_weights(angles.detach(), rows)[0].flatten()] = True
    return nodes[tiles(rows, angles.device)].any(1)


@lru_cache(maxsize=16)
def tiles(rows: int, device: torch.device = CPU) -> Tensor:
    """Returns the nodes of each tile as indices into the flattened table, int64 [tiles, TILE²].

    `rows` is a multiple of TILE.
    """
    flat = torch.arange(2 * rows * rows, device=device).reshape(rows // TILE, TILE, 2 * rows // TILE, TILE)
    return flat.permute(0, 2, 1, 3).reshape(-1, TILE**2)


@lru_cache(maxsize=16)
def node_vectors(rows: int, device: torch.device = CPU) -> Tensor:
    """Returns the normals of a table's nodes in the camera's frame, float64 [rows · 2 rows, 3]."""
    polar = (torch.arange(rows, dtype=torch.float64) + 0.5) * (pi / rows)
    azimuth = (torch.arange(2 * rows, dtype=torch.float64) + 0.5) * (pi / rows) - pi
    grid = torch.stack(torch.meshgrid(polar, azimuth, indexing="ij"), dim=-1).reshape(-1, 2)
    return to_vectors(grid.flip(-1)).to(device)


@dataclass(frozen=True)
class Nodes:
    """Nodes of a table: their places in the flattened table [N] and their normals [N, 3]."""

    places: Tensor
    vectors: Tensor


def nodes_of(tile_mask: Tensor, rows: int, dtype: torch.dtype) -> Nodes:
    """Returns the nodes of the tiles that `tile_mask` (bool, as `touched` returns) marks, with normals of `dtype`."""
    places = tiles(rows, tile_mask.device)[tile_mask].flatten()
    return Nodes(places, node_vectors(rows, tile_mask.device)[places].to(dtype))


def nearest(angles: Tensor, rows: int) -> Tensor:
    """Returns the node nearest to each pair of finite angles [P, 2], as indices into the flattened table: int64 [P]."""
    row = (angles[:, 1] * (rows / pi)).floor().long() % (2 * rows)
    column = (angles[:, 0] * (rows / pi) + rows).floor().long()
    past = row >= rows
    row = torch.where(past, 2 * rows - 1 - row, row)
    return row * (2 * rows) + (column + rows * past) % (2 * rows)


def unevenness(table: Tensor, filled: Tensor) -> Tensor:
    """Scores how badly a spline may fit around each node: largest second and fourth differences, [2, nodes].

    The differences are taken along both angles, of the sum over the channels; each node gets the largest among itself
    and its eight neighbours. A table's error follows the fourth difference where radiance has a kink or a highlight;
    the second difference serves nodes with too few filled neighbours for the fourth. `filled` [tiles] marks the tiles
    of `table` [nodes, 3] that hold values; the scores of other nodes mean nothing.
    """
    rows = _rows(table)
    if compiled.runs(table):
        uneven = table.new_empty(2, len(table))
        compiled.call("unevenness", table.dtype, rows, table.detach().contiguous(), filled, uneven)
        return uneven
    values = torch.full((len(table),), torch.nan, dtype=table.dtype, device=table.device)
    places = tiles(rows, filled.device)[filled].flatten()
    values[places] = table.detach()[places].sum(1)
    values = values.reshape(rows, 2 * rows)
    beyond = values.roll(rows, 1)  # beyond a pole the rows repeat in reverse, shifted by half a turn
    values = torch.cat([beyond[:_BORDER].flip(0), values, beyond[-_BORDER:].flip(0)])
    scores = values.new_zeros(2, *values.shape)
    for along in (0, 1):
        second = _second_difference(values, along)
        fourth = _second_difference(second, along)
        scores = torch.maximum(scores, torch.stack((second, fourth)).abs_().nan_to_num_(0.0))
    for along in (1, 2):
        scores = torch.maximum(torch.maximum(scores.roll(1, along), scores.roll(-1, along)), scores)
    return scores[:, _BORDER:-_BORDER].flatten(1)


_BORDER = 3
"""Rows beyond each pole that `unevenness` uses: two for the fourth difference and one for the neighbour."""


def _second_difference(values: Tensor, along: int) -> Tensor:
    return values.roll(1, along) + values.roll(-1, along) - 2 * values


N_SORT_KEYS = 2 * 64 * 64
"""Number of sort keys: every value of `normal_sort_keys` is below it."""


def normal_sort_keys(angles: Tensor) -> Tensor:
    """Returns a sort key [P] for each pair of angles [P, 2], which puts neighbouring normals next to each other.

    The key counts the nodes of a table of 64 rows tile by tile.
    """
    rows = 64
    row = (angles[:, 1] * (rows / pi)).long().clamp(0, rows - 1)
    column = (angles[:, 0] * (rows / pi) + rows).long().clamp(0, 2 * rows - 1)
    tile = row // TILE * (2 * rows // TILE) + column // TILE
    return tile * TILE**2 + row % TILE * TILE + column % TILE


def _rows(table: Tensor) -> int:
    return isqrt(len(table) // 2)


class _LookUp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, table: Tensor, angles: Tensor) -> Tensor:
        table = table.contiguous()
        ctx.save_for_backward(table, angles)
        result = angles.new_empty(len(angles), 3)
        compiled.call("look_up", angles.dtype, len(angles), _rows(table), angles, table, result, compiled.threads())
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None]:
        table, angles = ctx.saved_tensors
        d_table = torch.empty_like(table) if ctx.needs_input_grad[0] else None
        d_angles = torch.empty_like(angles) if ctx.needs_input_grad[1] else None
        into = (gradient.contiguous(), d_angles, d_table, compiled.threads())
        compiled.call("look_up_backward", angles.dtype, len(angles), _rows(table), angles, table, *into)
        return d_table, d_angles


def _interpolation_weights(angles: Tensor, rows: int) -> tuple[Tensor, Tensor]:
    """Returns the 16 nodes [P, 16] around each pair of angles [P, 2] and their interpolation weights [P, 16]."""
    places = angles * (rows / pi) + torch.tensor([rows - 0.5, -0.5], dtype=angles.dtype, device=angles.device)
    corner = places.detach().floor()
    weights = _catmull_rom(places - corner)
    around = torch.arange(-1, 3, device=angles.device)
    column, row = (corner.long()[:, i, None] + around for i in (0, 1))
    row = row % (2 * rows)
    past = row >= rows
    row = torch.where(past, 2 * rows - 1 - row, row)
    column = (column[:, None, :] + rows * past[:, :, None]) % (2 * rows)
    nodes = row[:, :, None] * (2 * rows) + column
    return nodes.flatten(1), (weights[:, 1, :, None] * weights[:, 0, None, :]).flatten(1)


def _catmull_rom(f: Tensor) -> Tensor:
    """Returns the weights [..., 4] of the nodes at −1, 0, 1 and 2 for a position f in [0, 1)."""
    return 0.5 * torch.stack(
        (
            f * (-1 + f * (2 - f)),
            2 + f * f * (-5 + 3 * f),
            f * (1 + f * (4 - 3 * f)),
            f * f * (f - 1),
        ),
        dim=-1,
    )


def chosen_pixels(
    most: int, table: Tensor, filled: Tensor, rows: int, angles: Tensor, shaded: Tensor, base_color: Tensor
) -> Tensor:
    """Indices of at most `most` of the pixels, ascending; all of them where there are no more.

    table [nodes, 3] of `rows` rows with its `filled` tiles [tiles]; angles [P, 2]; shaded [P, 3], the looked-up
    radiance; base_color [P, 3].
    """
    count = len(angles)
    if count <= most:
        return torch.arange(count, device=angles.device)
    third = most // 3
    uneven = unevenness(table, filled)
    if compiled.runs(angles):
        chosen, number = torch.empty(most, dtype=torch.int64), torch.empty(1, dtype=torch.int64)
        image = (uneven, *(of.detach().contiguous() for of in (angles, shaded, base_color)))
        sizes = (most, third, count, rows, KNEE)
        compiled.call("choose_pixels", angles.dtype, *sizes, *image, chosen, number, compiled.threads())
        return chosen[: int(number)]
    linear = (shaded.detach() * base_color).clamp_(0.0, 1.0)
    steepness = (base_color * linear.add_(KNEE).rsqrt_()).amax(1)  # near enough to put pixels in order
    likely = uneven[:, nearest(angles.detach(), rows)] * steepness
    stride = count // (most - 2 * third)
    even = torch.arange(_start(shaded) % stride, count, stride, device=angles.device)[: most - 2 * third]
    pixels: Tensor = torch.unique(torch.cat([*likely.topk(third).indices, even]))
    return pixels


def _start(shaded: Tensor) -> int:
    """A number that changes with the image: the sum of its bits, which no order of summing changes."""
    bits = torch.int32 if shaded.dtype == torch.float32 else torch.int64
    return int(shaded.detach().contiguous().view(bits).sum(dtype=torch.int64))
