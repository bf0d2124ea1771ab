"""What the options of a scene cost: a CLEVR-style scene with one more of them at a time, some way into an attack."""

from collections.abc import Iterator, Mapping
from functools import partial

import torch
from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.placing import library
from services.accuracy.work_precision.clevr_subject import described
from services.accuracy.work_precision.timing import repeated
from services.attacks.seeds import generator
from services.rendering.factory import build
from services.rendering.image_error import image_error
from services.rendering.plan import Tolerance
from services.rendering.protocol import Parameters, Renderer
from services.rendering.pyrender_renderer.errors import REACH
from services.rendering.torch_renderer.error_estimates import MAX_PERTURBATION
from services.scenes.description import Scene
from services.scenes.resolve import resolve

TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, "exact")
REACHES = {"pyrender": REACH, "torch": MAX_PERTURBATION}
"""How far an attack moves a coordinate of each group."""


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
    plain = [one.model_copy(update={"material": "matte", "metallic": None, "roughness": None}) for one in whole.objects]
    yield "matte objects", whole.model_copy(update={"objects": tuple(plain), "floor": None, "shadows": None})
    yield "rubber and metal", whole.model_copy(update={"floor": None, "shadows": None})
    yield "floor", whole.model_copy(update={"shadows": None})
    yield "shadows", whole


def rows(size: tuple[int, int], enough: float) -> Iterator[SceneRow]:
    """Both renderers; `enough`: seconds for each time that is taken."""
    for name, description in scenes(size):
        scene, ground = resolve(description, library()), torch.tensor(description.ground)
        for kind, reach in REACHES.items():
            exact = build(scene, kind, tolerance="exact")
            values = moved(exact, reach)
            wanted = exact.render(values)[0].double()
            for tolerance in TOLERANCES:
                renderer = build(scene, kind, tolerance=tolerance)
                start = renderer.initial()
                given = {group: value.to(start[group].dtype) for group, value in values.items()}
                found = renderer.render(given)[0].double()
                error, pixels = image_error(found, wanted, ground.to(wanted))
                yield SceneRow(
                    scene=name,
                    renderer=kind,
                    tolerance=tolerance,
                    pixels=pixels,
                    mean=error.mean,
                    share=error.share,
                    largest=float((found - wanted).abs().max()),
                    estimate=renderer.plan.error,
                    seconds=repeated(partial(renderer.render, given), enough).median,
                )


def moved(renderer: Renderer, reach: Mapping[str, float]) -> Parameters:
    """The values of the groups that are attacked by default, each coordinate moved at random by up to its `reach`,
    {group: [1, ...]}: float64 rounded to float32, so that every tolerance renders the same ones."""
    found = {}
    for group in renderer.plan.groups:
        value = renderer.initial()[group].double()
        random = torch.rand(value.shape, generator=generator(0, "scene options", group), dtype=torch.float64)
        low, high = (bound.double() for bound in renderer.bounds()[group])
        found[group] = torch.clamp(value + reach[group] * (2 * random - 1), low, high).float().double()[None]
    return found
