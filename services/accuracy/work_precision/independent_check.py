"""How far the float64 shader, the report's reference, is from the independent program."""

from collections.abc import Iterator

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field

from services.accuracy.placing import library
from services.accuracy.work_precision import independent
from services.accuracy.work_precision.shading_rows import truth
from services.accuracy.work_precision.shading_subject import GROUPS, Subject
from services.attacks.seeds import generator
from services.rendering.torch_renderer.planner import exact_recipe
from services.rendering.torch_renderer.shader import Shader

PIXELS = 64
DIRECTIONS = 4
"""Random directions, of coordinates ±1, along which derivatives are compared in each group."""


class IndependentRow(BaseModel):
    """One comparison of the float64 shader with the independent program."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    material: str
    map: tuple[int, int]
    what: str
    pixels: int
    largest: float = Field(description="largest difference of displayed values, or of derivatives, relative")
    rms: float


def comparisons(of: Subject) -> Iterator[IndependentRow]:
    """Images and derivatives at the moved values, and images with normals from rays; on
    PIXELS pixels spread over the object."""
    places = torch.linspace(0, len(of.pixels) - 1, min(PIXELS, len(of.pixels))).long()
    some = of.only(places)
    source = library().environment("studio").radiance
    light = independent.Light(independent.texels(source, *of.map))
    wanted = truth(some, GROUPS)
    view, base = of.scene.view, some.surface.base_color.numpy().astype(np.longdouble)
    at = {group: value.numpy().astype(np.longdouble) for group, value in some.moved.items()}
    coverage, weights = some.coverage.numpy(), some.weights.numpy()

    def image(values: dict[str, independent.Number]) -> independent.Number:
        normals = independent.normals_of(values["normals"], view)
        shown: independent.Number = coverage * independent.displayed(
            light, view, normals, values["illumination"], values["material"], base
        )
        return shown

    def row(what: str, difference: independent.Number) -> IndependentRow:
        size = np.abs(difference).astype(np.float64)
        return IndependentRow(
            mesh=of.mesh,
            material=of.material,
            map=of.map,
            what=what,
            pixels=len(difference) if "normals by rays" in what else len(places),
            largest=float(size.max()),
            rms=float(np.sqrt((size**2).mean())),
        )

    yield row("image at the moved values", image(at) - wanted.image.numpy())
    for group in GROUPS:
        random = generator(0, "work-precision", "independent", group)
        off = []
        for _ in range(DIRECTIONS):
            signs = (torch.rand(some.moved[group].shape, generator=random, dtype=torch.float64) - 0.5).sign()
            step = at | {group: at[group] + 1j * np.longdouble(independent.STEP) * signs.numpy()}
            found = (weights * image(step).imag).sum() / independent.STEP
            size = float(wanted.gradients[group].norm() * signs.norm()) or 1.0
            off.append((found - float((wanted.gradients[group] * signs).sum())) / size)
        yield row(f"derivative by {group}, of ‖gradient‖·‖direction‖", np.array(off))
    own = {"normals": some.surface.angles, "illumination": some.intensity, "material": some.surface.material}
    start = {group: value.numpy().astype(np.longdouble) for group, value in own.items()}
    shaded = some.image(Shader(exact_recipe(of.sky), of.sky, some.surface, of.intensity), own).numpy()
    rays, whole = independent.normals_by_rays(of.scene, some.pixels.numpy())
    whole &= coverage[:, 0] == 1
    found = independent.displayed(light, view, rays[whole], start["illumination"], start["material"], base[whole])
    angles = independent.normals_of(start["normals"], view)[whole]
    yield row("normals by rays, radians", np.linalg.norm((rays[whole] - angles).astype(np.float64), axis=1))
    yield row("image at the scene's own values, normals by rays", found - shaded[whole])
