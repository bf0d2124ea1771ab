"""Observed orders of convergence of tables over normals, beside the order 3 of Catmull-Rom interpolation."""

from collections.abc import Iterator, Sequence
from math import log, sqrt

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.work_precision.shading_rows import TOO_FINE, ShadingRow
from services.rendering.torch_renderer.lookup_table import look_up, node_vectors
from services.rendering.torch_renderer.normals import to_vectors
from services.rendering.torch_renderer.planner import TABLE_ROWS

STATED = 3
"""Catmull-Rom's derivatives at the nodes are central differences, so that its values are off by h³ between them (Keys
1981), and the derivative of the curve by h²."""
FIRST_ROWS = 48
"""Errors of coarser tables are not in the fit: their spacing is wider than the highlights."""
ROUNDING = {"float32": 3e-6, "float64": 1e-12}
"""Errors below this are of the number type, not of the table, and are not in the fit."""
FEWEST = 4
"""Points that a fit needs."""


class OrderRow(BaseModel):
    """How fast one error falls with the spacing of a table's nodes: error ∝ spacing^order."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    what: str
    dtype: str
    map: tuple[int, int] | None = Field(description="null: a smooth function, not a map")
    per_pixel_texels: int | None
    error: str = Field(description="which error")
    stated: int = Field(description="order of the interpolation of smooth functions")
    order: float
    standard_error: float
    first_rows: int
    last_rows: int
    points: int


def slope(rows: Sequence[int], errors: Sequence[float]) -> tuple[float, float]:
    """Order of convergence and its standard error: least squares of log error on log spacing, of at least 3 points."""
    x, y = [-log(r) for r in rows], [log(e) for e in errors]
    n, mean_x, mean_y = len(x), sum(x) / len(x), sum(y) / len(y)
    spread = sum((a - mean_x) ** 2 for a in x)
    order = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True)) / spread
    residual = sum((b - mean_y - order * (a - mean_x)) ** 2 for a, b in zip(x, y, strict=True))
    return order, sqrt(residual / (n - 2) / spread)


def smooth_orders(angles: Tensor) -> Iterator[OrderRow]:
    """Orders for a function without edges, looked up at `angles` [P, 2]: the interpolation by itself."""
    at = angles.double()
    leaf = at.clone().requires_grad_()
    wanted = _smooth(to_vectors(leaf))
    (wanted_gradient,) = torch.autograd.grad(wanted.sum(), leaf)
    errors: dict[str, list[float]] = {"largest": [], "rms": [], "rms of the gradient by the normals": []}
    for rows in TABLE_ROWS:
        leaf = at.clone().requires_grad_()
        found = look_up(_smooth(node_vectors(rows)), leaf)
        (gradient,) = torch.autograd.grad(found.sum(), leaf)
        off = (found - wanted).detach()
        largest, *means = errors.values()
        largest.append(float(off.abs().max()))
        for values, error in zip(means, (off, gradient - wanted_gradient), strict=True):
            values.append(float(error.square().mean().sqrt()))
    for name, values in errors.items():
        stated = STATED - 1 if "gradient" in name else STATED
        yield from _fitted("a smooth function", "float64", None, None, name, stated, TABLE_ROWS, values)


def shading_orders(shading: Sequence[ShadingRow]) -> Iterator[OrderRow]:
    """Orders of the tables of the report, for each subject, map and number of texels summed per pixel."""
    tables = [row for row in shading if row.method == "table" and row.rms and TOO_FINE not in row.note]
    for kind in dict.fromkeys((r.mesh, r.dtype, r.map, r.per_pixel_texels) for r in tables):
        own = [r for r in tables if (r.mesh, r.dtype, r.map, r.per_pixel_texels) == kind]
        mesh, dtype, texels, per_pixel = kind
        rows = [r.rows or 0 for r in own]
        for name, values in (
            ("largest", [r.largest or 0.0 for r in own]),
            ("rms", [r.rms or 0.0 for r in own]),
            ("relative, of the normals' gradient", [r.gradient.get("normals", 0.0) for r in own]),
        ):
            stated = STATED - 1 if "gradient" in name else STATED
            yield from _fitted(mesh, dtype, texels, per_pixel, name, stated, rows, values)


def _fitted(
    what: str,
    dtype: str,
    texels: tuple[int, int] | None,
    per_pixel: int | None,
    error: str,
    stated: int,
    rows: Sequence[int],
    values: Sequence[float],
) -> Iterator[OrderRow]:
    """A row, if enough points are left above rounding and past the coarsest tables."""
    used = [(r, e) for r, e in zip(rows, values, strict=True) if r >= FIRST_ROWS and e > ROUNDING[dtype]]
    if len(used) < FEWEST:
        return
    order, standard_error = slope([r for r, _ in used], [e for _, e in used])
    yield OrderRow(
        what=what,
        dtype=dtype,
        map=texels,
        per_pixel_texels=per_pixel,
        error=error,
        stated=stated,
        order=order,
        standard_error=standard_error,
        first_rows=used[0][0],
        last_rows=used[-1][0],
        points=len(used),
    )


def _smooth(normals: Tensor) -> Tensor:
    """A smooth function [N, 3] of unit normals [N, 3]: three broad lobes without a horizon."""
    lights = torch.tensor([[0.6, 0.0, 0.8], [0.0, 0.8, 0.6], [-0.36, 0.48, 0.8]], dtype=normals.dtype)
    return (2 * (normals @ lights.T - 1)).exp()
