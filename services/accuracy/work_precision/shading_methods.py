"""Ways of shading one object, each timed and compared with the sum in float64: pictures and gradients."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.work_precision.shading_subject import GROUPS, Subject
from services.accuracy.work_precision.timing import shortest
from services.rendering.kernels import compiled
from services.rendering.plan import Tolerance
from services.rendering.torch_renderer.error_estimates import roughness
from services.rendering.torch_renderer.lookup_table import TILE, touched
from services.rendering.torch_renderer.planner import ROUGH_AT, ROWS, compile_plan, exact_recipe
from services.rendering.torch_renderer.shader import CHECKED, Method, Recipe, Shader
from services.settings import settings

SHARP = (0, 8, 32, 128)
TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, 1e-4, "exact")
LARGE = 0.05
"""A slope is large if it is more than so much of the group's largest: only such signs are compared."""
WANTED = 1e-3
"""A method misses, if its picture is off by more: the default tolerance of a job."""


class ShadingRow(BaseModel):
    """One way of shading. Errors are of displayed values in [0,1] at the covered pixels, against float64."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    material: str
    size: tuple[int, int] = Field(description="of the picture, height and width")
    pixels: int = Field(description="that the object covers")
    map: tuple[int, int] = Field(description="rows and columns of the environment map")
    method: str
    groups: tuple[str, ...] = Field(description="attacked; the others keep their values and have no gradient")
    dtype: str
    kernel: str
    rows: int | None = Field(description="of the table over normals; null: none")
    sharp: int = Field(description="directions summed at the pixels beside the table")
    tolerance: Tolerance | None = Field(None, description="of the plan that picked it; null: not by a plan")
    estimate: float | None = Field(None, description="the plan's estimate of the largest error")
    evaluations: int | None = Field(None, description="lobe values, or products with kept factors, of one picture")
    largest: float | None = Field(None, description="largest error of the picture")
    rms: float | None = Field(None, description="root mean square error of the picture")
    gradient: dict[str, float] = Field(default_factory=dict, description="relative error (L2) of each group's gradient")
    signs: dict[str, float] = Field(default_factory=dict, description="share of large slopes with the right sign")
    forward: float | None = Field(None, description="seconds of a picture")
    both: float | None = Field(None, description="seconds of a picture and its gradient")
    note: str = Field("", description="what went wrong; empty: nothing")


@dataclass(frozen=True)
class Way:
    """A way of shading: `recipe` and the plan's estimate, if a plan made it, for a subject."""

    method: str
    groups: tuple[str, ...]
    recipe: Callable[[Subject], tuple[Recipe, float | None]]
    dtype: str = "float32"
    kernel: str = "native"
    rows: int | None = None
    sharp: int = 0
    tolerance: Tolerance | None = None


def ways(quick: bool) -> list[Way]:
    """Every way that is compared; `quick` leaves out every second number of rows."""
    found = [
        Way("sum", GROUPS, _direct(torch.float64), "float64"),
        Way("sum", GROUPS, _direct(torch.float32)),
        Way("sum", GROUPS, _direct(torch.float32), kernel="torch"),
        Way("sum", GROUPS, _direct(torch.bfloat16), "bfloat16", kernel="torch"),
    ]
    sizes = ROWS[::2] if quick else ROWS
    for sharp in SHARP:
        found += [Way("table", GROUPS, _table(rows, sharp), rows=rows, sharp=sharp) for rows in sizes]
    wide = torch.float64
    found += [Way("table", GROUPS, _table(r, 32, wide), "float64", rows=r, sharp=32) for r in sizes]
    only = ("normals",)
    found += [Way("fixed table", only, _table(r, 32, method="cached_table"), rows=r, sharp=32) for r in sizes]
    found.append(Way("transport", ("illumination",), _transport))
    for groups in (GROUPS, *((group,) for group in GROUPS)):
        found += [Way("plan", groups, _planned(groups, t), tolerance=t) for t in TOLERANCES]
    return found


def _direct(dtype: torch.dtype) -> Callable[[Subject], tuple[Recipe, None]]:
    return lambda of: (replace(exact_recipe(of.sky), dtype=dtype), None)


def _transport(of: Subject) -> tuple[Recipe, None]:
    return replace(exact_recipe(of.sky), dtype=torch.float32, method="precomputed_transport", moving=False), None


def _table(
    rows: int, sharp: int, dtype: torch.dtype = torch.float32, method: Method = "summed"
) -> Callable[[Subject], tuple[Recipe, None]]:
    def made(of: Subject) -> tuple[Recipe, None]:
        plain = exact_recipe(of.sky)
        count = len(plain.active_texels)
        if sharp > count // 2:
            raise ValueError(f"{sharp} of {count} directions beside a table leave it little to do")
        order = roughness(of.surface, of.sky, of.intensity, GROUPS, ROUGH_AT).argsort(descending=True, stable=True)
        return replace(plain, dtype=dtype, method=method, rows=rows, per_pixel_texels=order[:sharp].sort().values), None

    return made


def _planned(groups: tuple[str, ...], tolerance: Tolerance) -> Callable[[Subject], tuple[Recipe, float]]:
    def made(of: Subject) -> tuple[Recipe, float]:
        [recipe], plan = compile_plan([of.surface], of.sky, of.intensity, groups, tolerance, of.size)
        return recipe, plan.error

    return made


@contextmanager
def kernel(wanted: str) -> Iterator[None]:
    """Shading by the compiled loops ("native") or by torch ("torch") within. Raises JobFailure where there are none."""
    before = os.environ.get("SCENE_ATTACK_KERNEL")
    try:
        os.environ["SCENE_ATTACK_KERNEL"] = wanted
        _forget()
        compiled.library()
        yield
    finally:
        if before is None:
            del os.environ["SCENE_ATTACK_KERNEL"]
        else:
            os.environ["SCENE_ATTACK_KERNEL"] = before
        _forget()


def _forget() -> None:
    settings.cache_clear()
    compiled.library.cache_clear()


@dataclass(frozen=True)
class Truth:
    """Picture [P, 3] and gradients of a subject in float64, with the groups that are not attacked at their start."""

    picture: Tensor
    gradients: dict[str, Tensor]


def truth(of: Subject, groups: tuple[str, ...]) -> Truth:
    """By the sum over every direction and lobe, in float64."""
    recipe = exact_recipe(of.sky)
    values = values_of(of, groups)
    picture, gradients = derived(of, Shader(recipe, of.sky, of.surface, of.intensity), values, groups)
    return Truth(picture, gradients)


def values_of(of: Subject, groups: tuple[str, ...]) -> dict[str, Tensor]:
    """The moved values of the attacked groups, the scene's own of the others."""
    own = {"normals": of.surface.angles, "illumination": of.intensity, "material": of.surface.material}
    return {group: of.moved[group] if group in groups else own[group] for group in GROUPS}


def derived(
    of: Subject, shader: Shader, values: dict[str, Tensor], groups: tuple[str, ...]
) -> tuple[Tensor, dict[str, Tensor]]:
    """The picture [P, 3] and the gradient of its weighted sum for each of `groups`, as float64."""
    dtype = shader.recipe.dtype
    leaves = {g: v.to(dtype).detach().requires_grad_(g in groups) for g, v in values.items()}
    picture = of.picture(shader, leaves)
    slopes = torch.autograd.grad(of.value(picture), [leaves[group] for group in groups])
    return picture.detach().double(), {g: s.double() for g, s in zip(groups, slopes, strict=True)}


def row(way: Way, of: Subject, reference: Truth, enough: float) -> ShadingRow:
    """A way measured on a subject, for about `enough` seconds for each time taken; what it raises becomes its note."""
    known = ShadingRow(
        mesh=of.mesh,
        material=of.material,
        size=of.size,
        pixels=len(of.surface.angles),
        map=of.map,
        method=way.method,
        groups=way.groups,
        dtype=way.dtype,
        kernel=way.kernel,
        rows=way.rows,
        sharp=way.sharp,
        tolerance=way.tolerance,
    )
    try:
        with kernel(way.kernel):
            recipe, estimate = way.recipe(of)
            return known.model_copy(
                update={
                    "dtype": str(recipe.dtype).removeprefix("torch."),
                    "rows": recipe.rows,
                    "sharp": len(recipe.per_pixel_texels),
                    "estimate": estimate,
                }
                | _measured(way, of, reference, recipe, enough)
            )
    except Exception as error:  # the report says so, and the others go on
        return known.model_copy(update={"note": f"{type(error).__name__}: {str(error).splitlines()[0]}"})


def _measured(way: Way, of: Subject, reference: Truth, recipe: Recipe, enough: float) -> dict[str, object]:
    shader = Shader(recipe, of.sky, of.surface, of.intensity)
    values = values_of(of, way.groups)
    picture, gradients = derived(of, shader, values, way.groups)  # warms up, too
    off = (picture - reference.picture).abs()
    narrow = {group: value.to(recipe.dtype) for group, value in values.items()}

    def forward() -> None:
        with torch.no_grad():
            of.picture(shader, narrow)

    largest = float(off.max())
    limit = way.tolerance if isinstance(way.tolerance, float) else WANTED
    note = "" if largest <= limit else f"misses {limit:.0e}"
    if shader.summed_after_all:
        note = f"{note}; checked, and summed pixel by pixel after all".removeprefix("; ")
    return {
        "evaluations": evaluations(recipe, values["normals"]),
        "largest": largest,
        "rms": float(off.square().mean().sqrt()),
        "gradient": {g: relative(gradients[g], reference.gradients[g]) for g in way.groups},
        "signs": {g: signs(gradients[g], reference.gradients[g]) for g in way.groups},
        "forward": shortest(forward, enough),
        "both": shortest(lambda: derived(of, shader, values, way.groups), enough),
        "note": note,
    }


def evaluations(recipe: Recipe, angles: Tensor) -> int:
    """Lobe values of one picture at angles [P, 2]; where factors are kept, products instead. Lookups are not counted,
    nor the values of a table that is filled once."""
    each = recipe.channels * (1 if recipe.method == "precomputed_transport" else max(recipe.lobes, 1))
    kept, sharp = len(recipe.active_texels), len(recipe.per_pixel_texels)
    if recipe.rows is None:
        return len(angles) * kept * each
    nodes = 0 if recipe.method == "cached_table" else int(touched(angles, recipe.rows).sum()) * TILE**2
    checked = 0 if recipe.guard is None else min(CHECKED, len(angles)) * kept
    return (nodes * (kept - sharp) + len(angles) * sharp + checked) * each


def relative(found: Tensor, wanted: Tensor) -> float:
    """‖found − wanted‖ / ‖wanted‖."""
    return float((found - wanted).norm() / wanted.norm())


def signs(found: Tensor, wanted: Tensor) -> float:
    """Share of the large components of `wanted` whose sign is that of `found`."""
    large = wanted.abs() > LARGE * wanted.abs().amax()
    return float((found.sign() == wanted.sign())[large].double().mean())
