"""Methods of shading measured on one object: error of images and gradients, signs, seconds."""

from dataclasses import dataclass

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.work_precision.shading_methods import ShadingMethod, kernel
from services.accuracy.work_precision.shading_subject import GROUPS, Subject
from services.accuracy.work_precision.signs import wrong_signs
from services.accuracy.work_precision.timing import Times, repeated
from services.rendering.plan import Tolerance
from services.rendering.torch_renderer.lookup_table import TILE, touched
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Recipe, Shader, checked_pixels

TOO_FINE = "summed, as the table has no fewer nodes than the object pixels"
WANTED = 1e-3
"""A method misses if its image is off by more than this: the default tolerance of a job."""


class ShadingRow(BaseModel):
    """One method of shading. Errors are of displayed values in [0,1] at the covered pixels, against float64."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    material: str
    size: tuple[int, int] = Field(description="of the image, height and width")
    pixels: int = Field(description="that the object covers")
    map: tuple[int, int] = Field(description="rows and columns of the environment map")
    method: str
    groups: tuple[str, ...] = Field(description="attacked; the others keep their values and have no gradient")
    dtype: str
    kernel: str
    rows: int | None = Field(description="of the table over normals; null: none")
    per_pixel_texels: int = Field(description="texels of the map summed at the pixels beside the table")
    tolerance: Tolerance | None = Field(None, description="of the plan that picked it; null: not by a plan")
    estimate: float | None = Field(None, description="the plan's estimate of the largest error")
    evaluations: int | None = Field(None, description="lobe values, or products with kept factors, of one image")
    largest: float | None = Field(None, description="largest error of the image; null: the method failed")
    rms: float | None = Field(None, description="root mean square error of the image")
    gradient: dict[str, float] = Field(default_factory=dict, description="relative error (L2) of each group's gradient")
    wrong_signs: dict[str, float] = Field(default_factory=dict, description="share of wrong signs in each group")
    wrong_weight: dict[str, float] = Field(
        default_factory=dict,
        description="the same, each coordinate weighted by its part of the gradient's absolute sum",
    )
    forward: Times | None = Field(None, description="seconds of an image")
    both: Times | None = Field(None, description="seconds of an image and its gradient")
    note: str = Field("", description="what went wrong; empty: nothing")


class CannotRunRow(BaseModel):
    """Methods that make no sense for one subject, and why."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    map: tuple[int, int]
    why: str
    methods: int = Field(description="how many")


@dataclass(frozen=True)
class Truth:
    """Image [P, 3] and gradients of a subject in float64, with the groups that are not attacked at their start."""

    image: Tensor
    gradients: dict[str, Tensor]


def truth(of: Subject, groups: tuple[str, ...]) -> Truth:
    """By the sum over every direction and lobe, in float64."""
    recipe = exact_recipe(of.sky)
    values = values_of(of, groups)
    image, gradients = derived(of, Shader(recipe, of.sky, of.surface, of.intensity), values, groups)
    return Truth(image, gradients)


def values_of(of: Subject, groups: tuple[str, ...]) -> dict[str, Tensor]:
    """The moved values of the attacked groups, the scene's own of the others."""
    own = {"normals": of.surface.angles, "illumination": of.intensity, "material": of.surface.material}
    return {group: of.moved[group] if group in groups else own[group] for group in GROUPS}


def derived(
    of: Subject, shader: Shader, values: dict[str, Tensor], groups: tuple[str, ...]
) -> tuple[Tensor, dict[str, Tensor]]:
    """The image [P, 3] and the gradient of its weighted sum for each of `groups`, as float64."""
    dtype = shader.recipe.dtype
    leaves = {g: v.to(dtype).detach().requires_grad_(g in groups) for g, v in values.items()}
    image = of.image(shader, leaves)
    found = torch.autograd.grad(of.value(image), [leaves[group] for group in groups])
    return image.detach().double(), {g: s.double() for g, s in zip(groups, found, strict=True)}


def row(method: ShadingMethod, of: Subject, reference: Truth, enough: float) -> ShadingRow:
    """A method measured on a subject, for about `enough` seconds for each time taken. What it raises becomes a note."""
    known = ShadingRow(
        mesh=of.mesh,
        material=of.material,
        size=of.size,
        pixels=len(of.surface.angles),
        map=of.map,
        method=method.name,
        groups=method.groups,
        dtype=method.dtype,
        kernel=method.kernel,
        rows=method.rows,
        per_pixel_texels=method.per_pixel_texels,
        tolerance=method.tolerance,
    )
    try:
        with kernel(method.kernel):
            recipe, estimate = method.recipe(of)
            return known.model_copy(
                update={
                    "dtype": str(recipe.dtype).removeprefix("torch."),
                    "rows": recipe.rows,
                    "per_pixel_texels": len(recipe.per_pixel_texels),
                    "estimate": estimate,
                }
                | _measured(method, of, reference, recipe, enough)
            )
    except Exception as error:  # the report says so, and the others go on
        return known.model_copy(update={"note": f"{type(error).__name__}: {str(error).splitlines()[0]}"})


def _measured(method: ShadingMethod, of: Subject, reference: Truth, recipe: Recipe, enough: float) -> dict[str, object]:
    shader = Shader(recipe, of.sky, of.surface, of.intensity)
    values = values_of(of, method.groups)
    image, gradients = derived(of, shader, values, method.groups)  # warms up, too
    off = (image - reference.image).abs()
    narrow = {group: value.to(recipe.dtype) for group, value in values.items()}

    def forward() -> None:
        with torch.no_grad():
            of.image(shader, narrow)

    largest = float(off.max())
    limit = method.tolerance if isinstance(method.tolerance, float) else WANTED
    note = "" if largest <= limit else f"misses {limit:.0e}"
    if too_fine(recipe, values["normals"]):
        note = f"{note}; {TOO_FINE}".removeprefix("; ")
    if shader.summed_after_all:
        note = f"{note}; checked, and summed pixel by pixel after all".removeprefix("; ")
    signs = {g: wrong_signs(gradients[g].flatten(), reference.gradients[g].flatten()) for g in method.groups}
    return {
        "evaluations": evaluations(recipe, values["normals"]),
        "largest": largest,
        "rms": float(off.square().mean().sqrt()),
        "gradient": {g: relative(gradients[g], reference.gradients[g]) for g in method.groups},
        "wrong_signs": {g: wrong.share for g, wrong in signs.items()},
        "wrong_weight": {g: wrong.weight for g, wrong in signs.items()},
        "forward": repeated(forward, enough),
        "both": repeated(lambda: derived(of, shader, values, method.groups), enough),
        "note": note,
    }


def evaluations(recipe: Recipe, angles: Tensor) -> int:
    """Lobe values of one image at angles [P, 2]; where factors are kept, products instead. Lookups are not counted,
    nor the values of a table that is filled once."""
    each = recipe.channels * (1 if recipe.method == "precomputed_transport" else max(recipe.lobes, 1))
    kept, sharp = len(recipe.active_texels), len(recipe.per_pixel_texels)
    if recipe.rows is None or too_fine(recipe, angles):
        return len(angles) * kept * each
    nodes = 0 if recipe.method == "cached_table" else int(touched(angles, recipe.rows).sum()) * TILE**2
    checked = 0 if recipe.guard is None else min(checked_pixels(recipe), len(angles)) * kept
    return (nodes * (kept - sharp) + len(angles) * sharp + checked) * each


def too_fine(recipe: Recipe, angles: Tensor) -> bool:
    """Whether the shader sums at the pixels, as the table that is filled anew for each image has no fewer nodes."""
    if recipe.rows is None or not recipe.moving or recipe.method != "summed":
        return False
    return int(touched(angles, recipe.rows).sum()) * TILE**2 >= len(angles)


def relative(found: Tensor, wanted: Tensor) -> float:
    """‖found − wanted‖ / ‖wanted‖."""
    return float((found - wanted).norm() / wanted.norm())
