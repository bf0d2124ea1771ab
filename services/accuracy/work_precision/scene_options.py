"""Cost and error of a scene's options: sizes of its map and of its shadows, surfaces, a floor, shadows."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from statistics import median
from time import perf_counter

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.placing import library, placed
from services.attacks.problem import generator
from services.rendering.factory import build
from services.rendering.plan import Tolerance, image_error
from services.rendering.protocol import Parameters, Renderer
from services.rendering.pyrender_renderer.planner import MEASURED_REACH
from services.rendering.torch_renderer.planner import MAX_PERTURBATION
from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import generate
from services.scenes.description import Scene
from services.scenes.resolve import ResolvedScene, resolve

OBJECTS = 5
SCENE = f"CLEVR, {OBJECTS} objects"
MATERIALS = ("matte", "plastic", "glossy-paint", "brushed-metal")
MAP_SIZES = ((64, 128), (4, 8), (8, 16), (16, 32), (32, 64))
"""Sizes of the environment map, the largest first."""
SHADOWS: dict[str, list[dict[str, int]]] = {
    "pyrender": [
        {"resolution": resolution, "samples": samples}
        for resolution, samples in ((3072, 64), (256, 16), (512, 16), (1024, 4), (1024, 16), (1024, 64), (2048, 16))
    ],
    "torch": [{"texel_samples": side} for side in (8, 1, 2, 4)],
}
"""Fields of a scene's shadows that make them finer, by renderer, the finest first."""
TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, "exact")
REACHES = {"pyrender": MEASURED_REACH, "torch": MAX_PERTURBATION}
"""Distance by which an attack moves a coordinate of each group, by renderer."""
LEAST, MOST = 5, 15
"""Repeats of what is timed. Work that takes longer than LONG seconds is repeated three times."""
LONG = 1.0


class OptionRow(BaseModel):
    """The image of a scene by one renderer with one setting, beside a reference. Errors are of displayed values in
    [0,1]."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scene: str
    renderer: str
    setting: str
    mean: float = Field(description="mean error over covered pixels")
    share: float = Field(description="share of covered pixels that are off by more than 1/255")
    largest: float
    estimate: float | None = Field(None, description="the plan's: of the largest error (torch), or of the mean")
    seconds: float = Field(description="median, of an image")

    @classmethod
    def of(cls, image: Tensor, reference: Tensor, ground: Tensor, **known: str | float) -> "OptionRow":
        """The errors of an image [H, W, 3] with a ground of this colour [3]; `known` are the other fields."""
        image, reference = image.double(), reference.double()
        error, _ = image_error(image, reference, ground.to(reference))
        largest = float((image - reference).abs().max())
        return cls.model_validate(known | {"mean": error.mean, "share": error.share, "largest": largest})


def map_rows(mesh: str, size: tuple[int, int], enough: float) -> Iterator[OptionRow]:
    """Every material under every size of the studio map, by the torch renderer."""
    for material in MATERIALS:
        scenes = {
            f"{rows}×{columns} texels": placed(
                mesh,
                size=size,
                thing={"material": material},
                lights={"environment": {"map": "studio", "size": (rows, columns)}},
            )
            for rows, columns in MAP_SIZES
        }
        yield from _beside_the_first(material, "torch", scenes, enough)


def shadow_rows(size: tuple[int, int], enough: float) -> Iterator[OptionRow]:
    """Every fineness of shadows by both renderers, under three point lights, or their spots on a map."""
    scene = described(size)
    assert scene.shadows is not None
    for renderer, settings in SHADOWS.items():
        scenes = {}
        for fields in settings:
            shadows = scene.shadows.model_copy(update=fields)
            words = ", ".join(f"{name} {value}" for name, value in fields.items())
            scenes[words] = resolve(scene.model_copy(update={"shadows": shadows}), library())
        yield from _beside_the_first(SCENE, renderer, scenes, enough)


def _beside_the_first(
    name: str, renderer: str, scenes: Mapping[str, ResolvedScene], enough: float
) -> Iterator[OptionRow]:
    """The exact images of scenes, by their setting, beside that of the first, at their own values.

    Seconds are of an image and of making its renderer, because the torch renderer finds there what is visible.
    """
    (_, finest), *others = scenes.items()
    reference, ground = _exact_image(finest, renderer), torch.tensor(finest.description.ground)
    for setting, scene in others:
        image, seconds = _exact_image(scene, renderer), repeated(partial(_exact_image, scene, renderer), enough)
        yield OptionRow.of(image, reference, ground, scene=name, renderer=renderer, setting=setting, seconds=seconds)


def _exact_image(scene: ResolvedScene, renderer: str) -> Tensor:
    return build(scene, renderer, tolerance="exact").render({})[0]


def option_rows(size: tuple[int, int], enough: float) -> Iterator[OptionRow]:
    """A scene with one option more at a time, some way into an attack, by both renderers at each tolerance."""
    for name, description in scenes(size):
        scene, ground = resolve(description, library()), torch.tensor(description.ground)
        for kind, reach in REACHES.items():
            exact = build(scene, kind, tolerance="exact")
            values = moved(exact, reach)
            reference = exact.render(values)[0]
            for tolerance in TOLERANCES:
                renderer = build(scene, kind, tolerance=tolerance)
                start = renderer.initial()
                parameters = {group: value.to(start[group].dtype) for group, value in values.items()}
                yield OptionRow.of(
                    renderer.render(parameters)[0],
                    reference,
                    ground,
                    scene=name,
                    renderer=kind,
                    setting=str(tolerance),
                    estimate=renderer.plan.error,
                    seconds=repeated(partial(renderer.render, parameters), enough),
                )


def described(size: tuple[int, int]) -> Scene:
    """A CLEVR-style scene with a floor, metal and shadows, the same every time. `size`: height and width in pixels."""
    return describe(generate(0, 0, objects=(OBJECTS, OBJECTS)), size)


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
