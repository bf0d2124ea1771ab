"""Plans of the torch renderer for one object: errors of images and gradients, and seconds, at each tolerance."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import NamedTuple

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor
from torch.nn.functional import interpolate

from services.accuracy.placing import placed
from services.accuracy.work_precision.scene_options import moved, repeated
from services.attacks.problem import generator
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.plan import Tolerance
from services.rendering.protocol import Parameters, Renderer
from services.rendering.torch_renderer.planner import MAX_PERTURBATION
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.scenes.resolve import ResolvedScene

GROUPS = ("normals", "illumination", "material")
TOLERANCES: tuple[Tolerance, ...] = (1e-2, 1e-3, 1e-4, "exact")
REACH = {group: 0.1 * reach for group, reach in MAX_PERTURBATION.items()}
"""Distance by which a coordinate of each group is moved, at most: some way into an attack."""
COARSE = 14
"""Squares a side of the random numbers that an image's weights are smoothed from."""


class ShadingRow(BaseModel):
    """One plan for one object. Errors are against the exact renderer, of displayed values in [0,1]."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    mesh: str
    material: str
    size: tuple[int, int] = Field(description="of the image, height and width")
    map: tuple[int, int] = Field(description="rows and columns of the environment map")
    groups: tuple[str, ...] = Field(description="attacked; the others keep their values and have no gradient")
    tolerance: Tolerance
    estimate: float = Field(description="the plan's estimate of the largest error")
    largest: float
    gradient: dict[str, float] = Field(description="relative error (L2) of each group's gradient")
    seconds: float = Field(description="median, of an image and its gradient")
    summed: bool = Field(description="whether a check failed, so that pixels were summed one by one after all")

    @property
    def object(self) -> str:
        """The mesh without its folder, and the material."""
        return f"{self.mesh.removeprefix('furniture/')}, {self.material}"


class Shaded(NamedTuple):
    """An image [H, W, 3] and the gradient of its weighted sum for each attacked group, as float64."""

    image: Tensor
    gradients: Parameters


def subject(mesh: str, material: str, size: tuple[int, int], texels: tuple[int, int]) -> ResolvedScene:
    """A furniture model of one material under the studio map of so many texels. Raises as `resolve` does."""
    lights = {"environment": {"map": "studio", "size": texels}}
    return placed(mesh, size=size, thing={"material": material}, lights=lights)


def rows(
    mesh: str,
    material: str,
    size: tuple[int, int],
    texels: tuple[int, int],
    enough: float,
    tolerances: Sequence[Tolerance] = TOLERANCES,
) -> Iterator[ShadingRow]:
    """The plans for all groups, and for each alone, each for about `enough` seconds."""
    scene, weights = subject(mesh, material, size, texels), smooth_weights(size)
    gbuffer = rasterise(scene)
    for groups in (GROUPS, *((group,) for group in GROUPS)):
        exact = TorchRenderer(scene, gbuffer, groups, "exact")
        values = moved(exact, REACH)
        reference = shaded(exact, values, weights)
        for tolerance in tolerances:
            renderer = TorchRenderer(scene, gbuffer, groups, tolerance)
            image, gradients = shaded(renderer, values, weights)
            off = {group: (gradients[group] - true).norm() / true.norm() for group, true in reference.gradients.items()}
            yield ShadingRow(
                mesh=mesh,
                material=material,
                size=size,
                map=texels,
                groups=groups,
                tolerance=tolerance,
                estimate=renderer.plan.error,
                largest=float((image - reference.image).abs().max()),
                gradient={group: float(error) for group, error in off.items()},
                seconds=repeated(partial(shaded, renderer, values, weights), enough),
                summed=renderer.failed_checks > 0,
            )


def shaded(renderer: Renderer, values: Parameters, weights: Tensor) -> Shaded:
    """The image of `values`, {group: [1, ...]}, and the gradients of ⟨weights [H, W, 3], image⟩."""
    dtypes = {group: value.dtype for group, value in renderer.initial().items()}
    leaves = {group: value.to(dtypes[group]).detach().requires_grad_() for group, value in values.items()}
    image = renderer.render(leaves)[0].double()
    gradients = torch.autograd.grad((image * weights).sum(), list(leaves.values()))
    return Shaded(image.detach(), {group: of.double() for group, of in zip(leaves, gradients, strict=True)})


def smooth_weights(size: tuple[int, int]) -> Tensor:
    """Weights [H, W, 3] float64 of an image's values: random, smooth over an image's COARSEth, mean square 1.

    A network's gradient is of that kind; white noise would make every derivative a matter of single pixels.
    """
    random = torch.randn(1, 3, COARSE, COARSE, generator=generator(0, "work-precision", "weights"), dtype=torch.float64)
    smooth = interpolate(random, size, mode="bicubic")[0].permute(1, 2, 0)
    return smooth / smooth.square().mean().sqrt()
