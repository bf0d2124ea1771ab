"""Methods of shading one object that the report compares: sums, tables, transport and what a plan picks."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch

from services.accuracy.work_precision.shading_subject import GROUPS, Subject
from services.process import replaced
from services.rendering.kernels import compiled
from services.rendering.plan import Tolerance
from services.rendering.torch_renderer.error_estimates import roughness
from services.rendering.torch_renderer.planner import ROUGHNESS_ROWS, TABLE_ROWS, compile_plan, exact_recipe
from services.rendering.torch_renderer.shader import Method, Recipe

PER_PIXEL_TEXELS = (0, 8, 32, 128)
"""Texels of the map that are summed at each pixel beside a table."""
TOO_MANY = "more than half of the map's texels would be summed per pixel, which leaves the table little to do"
TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, 1e-4, "exact")


@dataclass(frozen=True)
class ShadingMethod:
    """A method of shading: `recipe` and the plan's estimate, if a plan made it, for a subject."""

    name: str
    groups: tuple[str, ...]
    recipe: Callable[[Subject], tuple[Recipe, float | None]]
    dtype: str = "float32"
    kernel: str = "native"
    rows: int | None = None
    per_pixel_texels: int = 0
    tolerance: Tolerance | None = None

    def suits(self, texels: tuple[int, int]) -> bool:
        """Whether the method makes sense for a map of `texels` rows and columns (see TOO_MANY)."""
        return 2 * self.per_pixel_texels <= texels[0] * texels[1]


def methods(quick: bool) -> list[ShadingMethod]:
    """Every method that is compared; `quick` leaves out every second number of rows."""
    found = [
        ShadingMethod("sum", GROUPS, _direct(torch.float64), "float64"),
        ShadingMethod("sum", GROUPS, _direct(torch.float32)),
        ShadingMethod("sum", GROUPS, _direct(torch.float32), kernel="torch"),
        ShadingMethod("sum", GROUPS, _direct(torch.bfloat16), "bfloat16", kernel="torch"),
    ]
    sizes = TABLE_ROWS[::2] if quick else TABLE_ROWS
    for texels in PER_PIXEL_TEXELS:
        found += [ShadingMethod("table", GROUPS, _table(r, texels), rows=r, per_pixel_texels=texels) for r in sizes]
    wide = torch.float64
    found += [
        ShadingMethod("table", GROUPS, _table(r, 32, wide), "float64", rows=r, per_pixel_texels=32) for r in sizes
    ]
    only = ("normals",)
    found += [
        ShadingMethod("fixed table", only, _table(r, 32, method="cached_table"), rows=r, per_pixel_texels=32)
        for r in sizes
    ]
    found.append(ShadingMethod("transport", ("illumination",), _transport))
    for groups in (GROUPS, *((group,) for group in GROUPS)):
        found += [ShadingMethod("plan", groups, _planned(groups, t), tolerance=t) for t in TOLERANCES]
    return found


def _direct(dtype: torch.dtype) -> Callable[[Subject], tuple[Recipe, None]]:
    return lambda of: (replace(exact_recipe(of.sky), dtype=dtype), None)


def _transport(of: Subject) -> tuple[Recipe, None]:
    return replace(exact_recipe(of.sky), dtype=torch.float32, method="precomputed_transport", moving=False), None


def _table(
    rows: int, texels: int, dtype: torch.dtype = torch.float32, method: Method = "summed"
) -> Callable[[Subject], tuple[Recipe, None]]:
    def made(of: Subject) -> tuple[Recipe, None]:
        plain = exact_recipe(of.sky)
        order = roughness(of.surface, of.sky, of.intensity, GROUPS, ROUGHNESS_ROWS).argsort(
            descending=True, stable=True
        )
        return replace(
            plain, dtype=dtype, method=method, rows=rows, per_pixel_texels=order[:texels].sort().values
        ), None

    return made


def _planned(groups: tuple[str, ...], tolerance: Tolerance) -> Callable[[Subject], tuple[Recipe, float]]:
    def made(of: Subject) -> tuple[Recipe, float]:
        [recipe], plan = compile_plan([of.surface], of.sky, of.intensity, groups, tolerance, of.size)
        return recipe, plan.error

    return made


@contextmanager
def kernel(wanted: str) -> Iterator[None]:
    """Shading by compiled kernels ("native") or torch ("torch") within. Raises JobFailure where there are none."""
    compiled.library.cache_clear()
    try:
        with replaced(kernel=wanted):
            compiled.library()
            yield
    finally:
        compiled.library.cache_clear()
