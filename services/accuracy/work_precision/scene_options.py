"""Cost and error of a scene's options: sizes of its map and of its shadows, surfaces, a floor, shadows."""

from collections.abc import Iterator, Mapping
from functools import partial

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.placing import library
from services.accuracy.work_precision.shading import repeated, subject, values_of
from services.attacks.problem import generator
from services.rendering.factory import build
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.plan import Tolerance, image_error
from services.rendering.protocol import Parameters, Renderer
from services.rendering.pyrender_renderer.planner import MEASURED_REACH
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.rendering.torch_renderer.planner import MAX_PERTURBATION, exact_recipe
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.rendering.torch_renderer.shader import Shader
from services.rendering.torch_renderer.surfaces import visibility
from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import generate
from services.scenes.description import Scene
from services.scenes.resolve import ResolvedScene, resolve

OBJECTS = 5
SCENE = f"CLEVR, {OBJECTS} objects"


def described(size: tuple[int, int]) -> Scene:
    """A CLEVR-style scene with a floor, metal and shadows, the same every time. `size`: height and width in pixels."""
    return describe(generate(0, 0, objects=(OBJECTS, OBJECTS)), size)


# The size of the environment map

MATERIALS = ("matte", "plastic", "glossy-paint", "brushed-metal")
MAP_SIZES = ((4, 8), (8, 16), (16, 32), (32, 64))
LARGEST_MAP = (64, 128)
MAP_PIXELS = 2000
"""Covered pixels that are compared, spread over the object."""


class MapRow(BaseModel):
    """One material under one size of the map: both images are exact sums in float64, at the scene's own values."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    material: str
    map: tuple[int, int]
    reference: tuple[int, int] = Field(description="size of the map of the other image")
    pixels: int
    largest: float = Field(description="largest difference of displayed values in [0,1]")
    rms: float


def map_rows(mesh: str, size: tuple[int, int]) -> Iterator[MapRow]:
    """Every material under every size of the studio map."""
    for material in MATERIALS:
        reference = _under_map(mesh, material, size, LARGEST_MAP)
        for texels in MAP_SIZES:
            off = (_under_map(mesh, material, size, texels) - reference).abs()
            yield MapRow(
                mesh=mesh,
                material=material,
                map=texels,
                reference=LARGEST_MAP,
                pixels=len(off),
                largest=float(off.max()),
                rms=float(off.square().mean().sqrt()),
            )


@torch.no_grad()
def _under_map(mesh: str, material: str, size: tuple[int, int], texels: tuple[int, int]) -> Tensor:
    """Displayed values [MAP_PIXELS, 3], of the same pixels whatever the map."""
    whole = subject(mesh, material, size, texels)
    of = whole.only(torch.linspace(0, len(whole.pixels) - 1, min(MAP_PIXELS, len(whole.pixels))).long())
    return of.image(Shader(exact_recipe(of.sky), of.sky, of.surface, of.intensity), values_of(of, groups=()))


# The fineness of shadows

SHADOW_MAPS = ((256, 16), (512, 16), (1024, 4), (1024, 16), (1024, 64), (2048, 16))
"""Texels a side, and samples of each light, of the pyrender renderer."""
FINEST_MAP = (4096, 64)
TEXELS = (1, 2, 4)
"""Directions a side of each texel, of the torch renderer."""
FINEST_TEXEL = 8


class ShadowRow(BaseModel):
    """One fineness of shadows: exact images at the scene's own values."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    renderer: str
    fineness: str
    reference: str
    pixels: int = Field(description="covered pixels that are compared")
    mean: float = Field(description="mean difference of displayed values in [0,1] over covered pixels")
    largest: float
    seconds: float = Field(description="median: of an image (pyrender), of finding the visibility once (torch)")


def shadow_rows(size: tuple[int, int], enough: float) -> Iterator[ShadowRow]:
    """Both renderers; `enough`: seconds for each time that is taken."""
    yield from _shadow_maps(size, enough)
    yield from _texels(size, enough)


def _with_shadows(size: tuple[int, int], shadows: dict[str, int]) -> ResolvedScene:
    """The scene under three point lights, or their spots on a map, with its shadows of another fineness."""
    scene = described(size)
    assert scene.shadows is not None
    return resolve(scene.model_copy(update={"shadows": scene.shadows.model_copy(update=shadows)}), library())


def _shadow_maps(size: tuple[int, int], enough: float) -> Iterator[ShadowRow]:
    def drawn(resolution: int, samples: int) -> PyrenderRenderer:
        return PyrenderRenderer(_with_shadows(size, {"resolution": resolution, "samples": samples}), tolerance="exact")

    finest = drawn(*FINEST_MAP)
    covered = finest.radiance({})[0, ..., 3] > 0
    finest_image = finest.render({})[0][covered]
    for resolution, samples in SHADOW_MAPS:
        renderer = drawn(resolution, samples)
        image = renderer.render({})[0][covered]
        seconds = repeated(partial(renderer.render, {}), enough).median
        yield _shadow_row(
            "pyrender", _map_words(resolution, samples), _map_words(*FINEST_MAP), image, finest_image, seconds
        )


def _map_words(resolution: int, samples: int) -> str:
    return f"{resolution}² texels, {samples} samples"


def _texels(size: tuple[int, int], enough: float) -> Iterator[ShadowRow]:
    scene = _with_shadows(size, {"texel_samples": FINEST_TEXEL})
    gbuffer = rasterise(scene)
    covered = gbuffer.coverage > 0
    finest_image = TorchRenderer(scene, gbuffer, tolerance="exact").render({})[0][covered]
    for side in TEXELS:
        coarse = _with_shadows(size, {"texel_samples": side})
        image = TorchRenderer(coarse, gbuffer, tolerance="exact").render({})[0][covered]
        seconds = repeated(partial(visibility, coarse, gbuffer.surfaces()), enough).median
        yield _shadow_row("torch", _texel_words(side), _texel_words(FINEST_TEXEL), image, finest_image, seconds)


def _texel_words(side: int) -> str:
    return f"{side}×{side} directions a texel"


def _shadow_row(
    renderer: str, fineness: str, reference: str, image: Tensor, finest_image: Tensor, seconds: float
) -> ShadowRow:
    off = (image - finest_image).abs().double()
    return ShadowRow(
        scene=SCENE,
        renderer=renderer,
        fineness=fineness,
        reference=reference,
        pixels=len(image),
        mean=float(torch.mean(off)),
        largest=float(off.max()),
        seconds=seconds,
    )


# One option more at a time

TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, "exact")
REACHES = {"pyrender": MEASURED_REACH, "torch": MAX_PERTURBATION}
"""Distance by which an attack moves a coordinate of each group, by renderer."""


class SceneRow(BaseModel):
    """One renderer at one tolerance, for attacks on its default groups. Errors are of displayed values in [0,1]."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str = Field(description="what it has, beside what the scenes before it have")
    renderer: str
    tolerance: Tolerance
    pixels: int = Field(description="covered pixels that are compared")
    mean: float = Field(description="mean difference to the exact image over covered pixels")
    share: float = Field(description="share of covered pixels that differ by more than 1/255")
    largest: float
    estimate: float = Field(description="the plan's estimate: of the largest (torch) or the mean error (rasterised)")
    seconds: float = Field(description="median, of an image")


def scenes(size: tuple[int, int]) -> Iterator[tuple[str, Scene]]:
    """The scene without its options, and with one more of them at a time."""
    whole = described(size)
    plain = [
        solid.model_copy(update={"material": "matte", "metallic": None, "roughness": None}) for solid in whole.objects
    ]
    yield "matte objects", whole.model_copy(update={"objects": tuple(plain), "floor": None, "shadows": None})
    yield "rubber and metal", whole.model_copy(update={"floor": None, "shadows": None})
    yield "floor", whole.model_copy(update={"shadows": None})
    yield "shadows", whole


def option_rows(size: tuple[int, int], enough: float) -> Iterator[SceneRow]:
    """Both renderers; `enough`: seconds for each time that is taken."""
    for name, description in scenes(size):
        scene, ground = resolve(description, library()), torch.tensor(description.ground)
        for kind, reach in REACHES.items():
            exact = build(scene, kind, tolerance="exact")
            values = moved(exact, reach)
            reference = exact.render(values)[0].double()
            for tolerance in TOLERANCES:
                renderer = build(scene, kind, tolerance=tolerance)
                start = renderer.initial()
                parameters = {group: value.to(start[group].dtype) for group, value in values.items()}
                image = renderer.render(parameters)[0].double()
                error, pixels = image_error(image, reference, ground.to(reference))
                yield SceneRow(
                    scene=name,
                    renderer=kind,
                    tolerance=tolerance,
                    pixels=pixels,
                    mean=error.mean,
                    share=error.share,
                    largest=float((image - reference).abs().max()),
                    estimate=renderer.plan.error,
                    seconds=repeated(partial(renderer.render, parameters), enough).median,
                )


def moved(renderer: Renderer, reach: Mapping[str, float]) -> Parameters:
    """The values of the groups that are attacked by default, each coordinate moved at random by up to its `reach`,
    {group: [1, ...]}: float64 rounded to float32, so that every tolerance renders the same ones."""
    parameters = {}
    for group in renderer.plan.groups:
        value = renderer.initial()[group].double()
        random = torch.rand(value.shape, generator=generator(0, "scene options", group), dtype=torch.float64)
        low, high = (bound.double() for bound in renderer.bounds()[group])
        parameters[group] = torch.clamp(value + reach[group] * (2 * random - 1), low, high).float().double()[None]
    return parameters
