"""Ways of shading one object: the sum in each type of number, and the plan of each tolerance. Errors, and median
seconds.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from statistics import median
from time import perf_counter
from typing import NamedTuple

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn.functional import interpolate

from services.accuracy.placing import placed
from services.attacks.problem import generator
from services.process import replaced
from services.rendering.color import to_display
from services.rendering.kernels import compiled
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.plan import Tolerance
from services.rendering.torch_renderer import table
from services.rendering.torch_renderer.dsbrdf import MATERIAL_UNIT, preset
from services.rendering.torch_renderer.light import illumination
from services.rendering.torch_renderer.planner import MAX_PERTURBATION, compile_plan, exact_recipe
from services.rendering.torch_renderer.renderer import sky_of
from services.rendering.torch_renderer.shader import Recipe, Shader, Sky, Surface
from services.rendering.torch_renderer.table import to_angles
from services.scenes.resolve import ResolvedScene

LEAST, MOST = 5, 15
"""Repeats. Work that takes longer than LONG seconds is repeated three times."""
LONG = 1.0


def repeated(work: Callable[[], object], enough: float) -> float:
    """Median seconds of LEAST to MOST repeats, as many as fit into `enough` seconds. Warm up before."""
    seconds = [_seconds(work)]
    least = LEAST if seconds[0] < LONG else 3
    while len(seconds) < least or (len(seconds) < MOST and sum(seconds) < enough):
        seconds.append(_seconds(work))
    return median(seconds)


def _seconds(work: Callable[[], object]) -> float:
    began = perf_counter()
    work()
    return perf_counter() - began


GROUPS = ("normals", "illumination", "material")
FAR = 0.1
"""Fraction of an attack's reach by which each coordinate of the scene is moved, with random signs."""
COARSE = 14
"""Squares a side of the random numbers that an image's weights are smoothed from."""
TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, 1e-4, "exact")
WANTED = 1e-3
"""A sum misses if its image is off by more than this: the default tolerance of a job."""


# The object


@dataclass(frozen=True)
class Subject:
    """A scene of one object, taken apart.

    scene: as it was resolved; pixels [P]: flat indices of its covered pixels; surface: of these; sky and intensity [D]:
    its light; moved: values of the three groups some way into an attack, float64; coverage [P, 1]; weights [P, 3]:
    those of the image in the function whose gradient is taken.
    """

    mesh: str
    material: str
    size: tuple[int, int]
    map: tuple[int, int]
    scene: ResolvedScene
    pixels: Tensor
    surface: Surface
    sky: Sky
    intensity: Tensor
    moved: dict[str, Tensor]
    coverage: Tensor
    weights: Tensor

    def image(self, shader: Shader, values: dict[str, Tensor]) -> Tensor:
        """Displayed values [P, 3] of the covered pixels, without the ground's share, in the recipe's dtype."""
        radiance = shader(values["normals"], values["illumination"], values["material"])
        shown = to_display(radiance * self.surface.base_color.to(radiance.dtype))
        return self.coverage.to(radiance.dtype) * shown

    def only(self, some: Tensor) -> "Subject":
        """The same subject with only the covered pixels at the indices `some`."""
        surface = replace(self.surface, angles=self.surface.angles[some], base_color=self.surface.base_color[some])
        return replace(
            self,
            pixels=self.pixels[some],
            surface=surface,
            moved=self.moved | {"normals": self.moved["normals"][some]},
            coverage=self.coverage[some],
            weights=self.weights[some],
        )

    def value(self, image: Tensor) -> Tensor:
        """⟨weights, image⟩, summed in float64."""
        return (image.double() * self.weights).sum()


def subject(mesh: str, material: str, size: tuple[int, int], texels: tuple[int, int]) -> Subject:
    """A furniture model of one material under the studio map of so many texels. Raises as `resolve` does."""
    scene = placed(
        mesh,
        size=size,
        thing={"material": material},
        lights={"environment": {"map": "studio", "size": texels}},
    )
    gbuffer = rasterise(scene)
    to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3]
    angles = to_angles(gbuffer.normals.double() @ to_camera).float().double().reshape(-1, 2)
    covered = gbuffer.coverage.flatten().nonzero()[:, 0]
    pixels = covered[torch.argsort(table.normal_sort_keys(angles[covered]), stable=True)]
    light = illumination(torch.as_tensor(scene.environment))
    sky, intensity = sky_of(light, to_camera), light.intensity.flatten().float().double()
    values = {
        "normals": angles[pixels],
        "illumination": intensity,
        "material": (preset(material) * MATERIAL_UNIT).float().double(),
    }
    surface = Surface(
        "object 0", values["normals"], gbuffer.base_color.reshape(-1, 3)[pixels].double(), values["material"]
    )
    coverage = gbuffer.coverage.flatten()[pixels, None].double()
    weights = smooth_weights(size).reshape(-1, 3)[pixels]
    return Subject(
        mesh, material, size, texels, scene, pixels, surface, sky, intensity, moved(values), coverage, weights
    )


def moved(values: dict[str, Tensor]) -> dict[str, Tensor]:
    """The values with every coordinate moved by FAR of its reach, up or down at random."""
    result = {}
    for group, value in values.items():
        random = generator(0, "work-precision", group)
        signs = (torch.rand(value.shape, generator=random, dtype=torch.float64) - 0.5).sign()
        result[group] = value + FAR * MAX_PERTURBATION[group] * signs
    result["illumination"].clamp_(min=0.0)
    return {group: value.float().double() for group, value in result.items()}


def smooth_weights(size: tuple[int, int]) -> Tensor:
    """Weights [H, W, 3] float64 of an image's values: random, smooth over an image's COARSEth, mean square 1.

    A network's gradient is of that kind; white noise would make every derivative a matter of single pixels.
    """
    random = torch.randn(1, 3, COARSE, COARSE, generator=generator(0, "work-precision", "weights"), dtype=torch.float64)
    smooth = interpolate(random, size, mode="bicubic")[0].permute(1, 2, 0)
    return smooth / smooth.square().mean().sqrt()


# The ways of shading it


@dataclass(frozen=True)
class ShadingMethod:
    """The plan of a tolerance, or without one the sum over all directions and lobes in a type of number."""

    groups: tuple[str, ...]
    dtype: torch.dtype = torch.float32
    kernel: str = "native"
    tolerance: Tolerance | None = None

    def recipe(self, of: Subject) -> tuple[Recipe, float | None]:
        """Returns the recipe by which a subject is shaded, and the plan's estimate of the largest error."""
        if self.tolerance is None:
            return replace(exact_recipe(of.sky), dtype=self.dtype), None
        [recipe], plan = compile_plan([of.surface], of.sky, of.intensity, self.groups, self.tolerance, of.size)
        return recipe, plan.error


def methods() -> Iterator[ShadingMethod]:
    """Every method that is compared."""
    yield ShadingMethod(GROUPS, torch.float64)
    yield ShadingMethod(GROUPS, torch.float32)
    yield ShadingMethod(GROUPS, torch.float32, "torch")
    yield ShadingMethod(GROUPS, torch.bfloat16, "torch")
    for groups in (GROUPS, *((group,) for group in GROUPS)):
        for tolerance in TOLERANCES:
            yield ShadingMethod(groups, tolerance=tolerance)


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


# What they come to


class ShadingRow(BaseModel):
    """One method of shading. Errors are of displayed values in [0,1] at the covered pixels, against float64."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    material: str
    size: tuple[int, int] = Field(description="of the image, height and width")
    map: tuple[int, int] = Field(description="rows and columns of the environment map")
    groups: tuple[str, ...] = Field(description="attacked; the others keep their values and have no gradient")
    dtype: str
    kernel: str
    tolerance: Tolerance | None = Field(description="of the plan; null: a sum")
    estimate: float | None = Field(None, description="the plan's estimate of the largest error")
    largest: float | None = Field(None, description="largest error of the image; null: the method failed")
    gradient: dict[str, float] = Field(default_factory=dict, description="relative error (L2) of each group's gradient")
    seconds: float | None = Field(None, description="median, of an image and its gradient")
    note: str = Field("", description="what went wrong; empty: nothing")

    @property
    def object(self) -> str:
        """The mesh without its folder, and the material."""
        return f"{self.mesh.removeprefix('furniture/')}, {self.material}"


def rows(of: Subject, enough: float) -> Iterator[ShadingRow]:
    """Every method on a subject, each for about `enough` seconds."""
    truths = {groups: truth(of, groups) for groups in dict.fromkeys(method.groups for method in methods())}
    for method in methods():
        yield row(method, of, truths[method.groups], enough)


class Shaded(NamedTuple):
    """An image [P, 3] and the gradient of its weighted sum for each attacked group, as float64."""

    image: Tensor
    gradients: dict[str, Tensor]


def truth(of: Subject, groups: tuple[str, ...]) -> Shaded:
    """Computes image and gradients by the sum over every direction and lobe, in float64."""
    recipe = exact_recipe(of.sky)
    return derived(of, Shader(recipe, of.sky, of.surface, of.intensity), values_of(of, groups), groups)


def values_of(of: Subject, groups: tuple[str, ...]) -> dict[str, Tensor]:
    """The moved values of the attacked groups, the scene's own of the others."""
    own = {"normals": of.surface.angles, "illumination": of.intensity, "material": of.surface.material}
    return {group: of.moved[group] if group in groups else own[group] for group in GROUPS}


def derived(of: Subject, shader: Shader, values: dict[str, Tensor], groups: tuple[str, ...]) -> Shaded:
    """The image of `values`, and its gradients for each of `groups`."""
    dtype = shader.recipe.dtype
    leaves = {g: v.to(dtype).detach().requires_grad_(g in groups) for g, v in values.items()}
    image = of.image(shader, leaves)
    gradients = torch.autograd.grad(of.value(image), [leaves[group] for group in groups])
    return Shaded(image.detach().double(), {g: s.double() for g, s in zip(groups, gradients, strict=True)})


def row(method: ShadingMethod, of: Subject, reference: Shaded, enough: float) -> ShadingRow:
    """A method measured on a subject, for about `enough` seconds. An error becomes a note."""
    known = ShadingRow(
        mesh=of.mesh,
        material=of.material,
        size=of.size,
        map=of.map,
        groups=method.groups,
        dtype=str(method.dtype).removeprefix("torch."),
        kernel=method.kernel,
        tolerance=method.tolerance,
    )
    try:
        with kernel(method.kernel):
            return known.model_copy(update=_measured(method, of, reference, enough))
    except Exception as error:  # the report says so, and the others go on
        return known.model_copy(update={"note": f"{type(error).__name__}: {str(error).splitlines()[0]}"})


def _measured(method: ShadingMethod, of: Subject, reference: Shaded, enough: float) -> dict[str, object]:
    recipe, estimate = method.recipe(of)
    shader = Shader(recipe, of.sky, of.surface, of.intensity)
    values = values_of(of, method.groups)
    image, gradients = derived(of, shader, values, method.groups)  # warms up, too
    largest = float((image - reference.image).abs().max())
    limit = method.tolerance if isinstance(method.tolerance, float) else WANTED
    notes = [f"misses {limit:.0e}"] if not largest <= limit else []  # NaN misses too
    if shader.summed_after_all:
        notes.append("checked, and summed pixel by pixel after all")
    return {
        "dtype": str(recipe.dtype).removeprefix("torch."),
        "estimate": estimate,
        "largest": largest,
        "gradient": {g: relative(gradients[g], reference.gradients[g]) for g in method.groups},
        "seconds": repeated(lambda: derived(of, shader, values, method.groups), enough),
        "note": "; ".join(notes),
    }


def relative(found: Tensor, wanted: Tensor) -> float:
    """‖found − wanted‖ / ‖wanted‖."""
    return float((found - wanted).norm() / wanted.norm())
