"""What averaging an environment map down costs: images under small maps beside the image under a large one."""

from collections.abc import Iterator

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from services.accuracy.work_precision.shading_subject import subject
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader

MATERIALS = ("matte", "plastic", "glossy-paint", "brushed-metal")
MAPS = ((4, 8), (8, 16), (16, 32), (32, 64))
REFERENCE = (64, 128)
PIXELS = 2000
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


def rows(mesh: str, size: tuple[int, int]) -> Iterator[MapRow]:
    """Every material under every size of the studio map."""
    for material in MATERIALS:
        wanted = _image(mesh, material, size, REFERENCE)
        for texels in MAPS:
            off = (_image(mesh, material, size, texels) - wanted).abs()
            yield MapRow(
                mesh=mesh,
                material=material,
                map=texels,
                reference=REFERENCE,
                pixels=len(off),
                largest=float(off.max()),
                rms=float(off.square().mean().sqrt()),
            )


@torch.no_grad()
def _image(mesh: str, material: str, size: tuple[int, int], texels: tuple[int, int]) -> Tensor:
    """Displayed values [PIXELS, 3], of the same pixels whatever the map."""
    whole = subject(mesh, material, size, texels)
    of = whole.only(torch.linspace(0, len(whole.pixels) - 1, min(PIXELS, len(whole.pixels))).long())
    values = {"normals": of.surface.angles, "illumination": of.intensity, "material": of.surface.material}
    return of.image(Shader(exact_recipe(of.sky), of.sky, of.surface, of.intensity), values)
