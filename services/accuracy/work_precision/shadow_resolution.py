"""What shadows cost and leave out: images with coarse maps and few samples beside one with the finest."""

from collections.abc import Iterator
from functools import partial

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.placing import library
from services.accuracy.work_precision.clevr_subject import SCENE, described
from services.accuracy.work_precision.timing import repeated
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.rendering.torch_renderer.visibility import visibility
from services.scenes.resolve import ResolvedScene, resolve

MAPS = ((256, 16), (512, 16), (1024, 4), (1024, 16), (1024, 64), (2048, 16))
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


def rows(size: tuple[int, int], enough: float) -> Iterator[ShadowRow]:
    """Both renderers; `enough`: seconds for each time that is taken."""
    yield from _maps(size, enough)
    yield from _texels(size, enough)


def _scene(size: tuple[int, int], shadows: dict[str, int]) -> ResolvedScene:
    """The scene under three point lights, or their spots on a map, with its shadows of another fineness."""
    scene = described(size)
    assert scene.shadows is not None
    return resolve(scene.model_copy(update={"shadows": scene.shadows.model_copy(update=shadows)}), library())


def _maps(size: tuple[int, int], enough: float) -> Iterator[ShadowRow]:
    def drawn(resolution: int, samples: int) -> PyrenderRenderer:
        return PyrenderRenderer(_scene(size, {"resolution": resolution, "samples": samples}), tolerance="exact")

    finest = drawn(*FINEST_MAP)
    covered = finest.radiance({})[0, ..., 3] > 0
    wanted = finest.render({})[0][covered]
    for resolution, samples in MAPS:
        renderer = drawn(resolution, samples)
        found = renderer.render({})[0][covered]
        seconds = repeated(partial(renderer.render, {}), enough).median
        yield _row("pyrender", _map_words(resolution, samples), _map_words(*FINEST_MAP), found, wanted, seconds)


def _map_words(resolution: int, samples: int) -> str:
    return f"{resolution}² texels, {samples} samples"


def _texels(size: tuple[int, int], enough: float) -> Iterator[ShadowRow]:
    scene = _scene(size, {"texel_samples": FINEST_TEXEL})
    gbuffer = rasterise(scene)
    covered = gbuffer.coverage > 0
    wanted = TorchRenderer(scene, gbuffer, tolerance="exact").render({})[0][covered]
    for side in TEXELS:
        coarse = _scene(size, {"texel_samples": side})
        found = TorchRenderer(coarse, gbuffer, tolerance="exact").render({})[0][covered]
        seconds = repeated(partial(visibility, coarse, gbuffer.surfaces()), enough).median
        yield _row("torch", _texel_words(side), _texel_words(FINEST_TEXEL), found, wanted, seconds)


def _texel_words(side: int) -> str:
    return f"{side}×{side} directions a texel"


def _row(renderer: str, fineness: str, reference: str, found: Tensor, wanted: Tensor, seconds: float) -> ShadowRow:
    off = (found - wanted).abs().double()
    return ShadowRow(
        scene=SCENE,
        renderer=renderer,
        fineness=fineness,
        reference=reference,
        pixels=len(found),
        mean=float(torch.mean(off)),
        largest=float(off.max()),
        seconds=seconds,
    )
