"""Gradients of the rasterising renderer: differences of its images, against references for each kind of number.

- The image is linear in ambient light, energies and colours before the display's curve: images at two values give
  the derivative, exactly but for float32.
- It is smooth in a light's position: Richardson's extrapolation of central differences, twice.
- Poses move silhouettes. An image of few samples a pixel jumps where an edge passes a sample, so that its derivative
  is that of another function. The reference is the derivative of the image it approximates, by extrapolated
  differences of images of many times the samples, averaged before display.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Protocol

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from services.accuracy.placing import placed
from services.accuracy.work_precision.gradients import IMAGE, Objective
from services.accuracy.work_precision.shading_subject import smooth_weights
from services.accuracy.work_precision.single_sample import Sampled
from services.rendering.color import as_saved
from services.rendering.compositing import over_ground
from services.rendering.factory import build
from services.rendering.protocol import Parameters
from services.rendering.pyrender_renderer.renderer import EXPOSURE, PyrenderRenderer
from services.scenes.resolve import ResolvedScene

POSITIONS = (0.02, 0.01, 0.005)
"""Half-steps whose differences are extrapolated for a light's position, scene units."""
POSES = (0.06, 0.03, 0.015)
"""The same for poses, in scene units and radians: larger, as even an averaged image's silhouette jumps."""
EXTRAPOLATED = "central differences at {}, extrapolated twice; uncertain by how far"
COLOR = (0.8, 0.7, 0.6)
"""Within the bounds by more than the largest step."""


@dataclass(frozen=True)
class _Part:
    """Some numbers of one group that have the same kind of reference."""

    name: str
    group: str
    indices: tuple[int, ...]


LINEAR = (_Part("light strength", "illumination", (0, 1)), _Part("color", "color", (0, 1, 2)))
SMOOTH = (_Part("light position", "illumination", (2, 3, 4)),)
MOVING = (_Part("translation", "translation", (0, 1, 2)), _Part("rotation", "rotation", (0, 1, 2)))


class _Draws(Protocol):
    def radiance(self, parameters: Mapping[str, Tensor]) -> Tensor: ...


def objectives(mesh: str, size: tuple[int, int], factor: int) -> Iterator[Objective]:
    """⟨weights, image⟩ of each kind of number, with one and with four samples a pixel, through float32 images and
    8 bits. References of poses take `factor`² times the pixels, and half as many to see what that leaves open."""
    scene, weights = _scene(mesh, size), smooth_weights(size)
    ground = torch.tensor(scene.description.ground, dtype=torch.float64)
    start = build(scene, "pyrender").initial()

    def function(radiance: Tensor, pooled: int = 1) -> Tensor:
        images = over_ground(_pooled(radiance, pooled).double(), EXPOSURE, ground)
        return (images * weights).sum(dim=(1, 2, 3))

    moving = {part.name: _of_poses(mesh, size, factor, part, start, function) for part in MOVING}
    for samples in (1, 4):
        renderer: _Draws = Sampled(scene, 1) if samples == 1 else PyrenderRenderer(scene)
        for part in (*LINEAR, *SMOOTH, *MOVING):
            if part in LINEAR:
                gradient, uncertainty = _of_linear(renderer, part, start, function), 0.0
                how = "the linear image's differences, exact, through the display's derivative in float64"
            elif part in SMOOTH:
                along = _along(renderer, part, start, function)
                gradient, uncertainty = _extrapolated(along, _at(part, start), POSITIONS)
                how = f"{EXTRAPOLATED.format(POSITIONS)} that moved the finest"
            else:
                gradient, uncertainty = moving[part.name]
                how = (
                    f"{EXTRAPOLATED.format(POSES)} that moved the finest; of images of {factor}² × 4 samples a "
                    f"pixel, and uncertain too by how far off those of {factor // 2}² × 4 are"
                )
            yield Objective(
                renderer="pyrender",
                group=part.name,
                of=IMAGE,
                images=("float32", "8 bit"),
                at=_at(part, start),
                coordinates=torch.arange(len(part.indices)),
                values=partial(_values, renderer, part, start, weights, ground),
                gradient=gradient,
                how=how,
                uncertainty=uncertainty,
                samples=samples,
            )


def _scene(mesh: str, size: tuple[int, int]) -> ResolvedScene:
    return placed(mesh, size=size, thing={"color": COLOR})


def _at(part: _Part, start: Parameters) -> Tensor:
    return start[part.group].flatten()[list(part.indices)]


def _parameters(part: _Part, start: Parameters, points: Tensor) -> dict[str, Tensor]:
    """The whole group for values [B, n] of the part's numbers."""
    whole = start[part.group].flatten().repeat(len(points), 1)
    whole[:, list(part.indices)] = points.double()
    return {part.group: whole.reshape(len(points), *start[part.group].shape)}


def _values(
    renderer: _Draws, part: _Part, start: Parameters, weights: Tensor, ground: Tensor, points: Tensor
) -> Tensor:
    """The function at points [B, n] through float32 and 8-bit images, [B, 2]."""
    columns = []
    for some in torch.split(points, 8):
        images = over_ground(renderer.radiance(_parameters(part, start, some)), EXPOSURE, ground)
        seen = torch.stack([images, as_saved(images)], dim=1)
        columns.append((seen.double() * weights).sum(dim=(2, 3, 4)))
    return torch.cat(columns)


def _along(
    renderer: _Draws, part: _Part, start: Parameters, function: Callable[[Tensor], Tensor]
) -> Callable[[Tensor], Tensor]:
    """The function at points [B, n], drawn one by one."""
    return lambda points: torch.cat(
        [function(renderer.radiance(_parameters(part, start, point[None]))) for point in points]
    )


def _of_linear(renderer: _Draws, part: _Part, start: Parameters, function: Callable[[Tensor], Tensor]) -> Tensor:
    """Gradient [n]. Radiance is here + Σ (x − x₀) (here − without) / x₀, with the number at 0 in `without`."""
    at = _at(part, start)
    points = torch.cat([at[None], at * (1 - torch.eye(len(at), dtype=at.dtype))])
    here, *without = renderer.radiance(_parameters(part, start, points)).double()
    unit = torch.stack([(here - image) / value for image, value in zip(without, at, strict=True)])
    leaf = torch.zeros_like(at).requires_grad_()
    value = function((here + torch.tensordot(leaf, unit, 1))[None]).sum()
    (gradient,) = torch.autograd.grad(value, leaf)
    return gradient


def _extrapolated(
    function: Callable[[Tensor], Tensor], at: Tensor, deltas: tuple[float, float, float]
) -> tuple[Tensor, float]:
    """Gradient [n] by central differences at half-steps that are halved twice, extrapolated (Richardson 1911); and how
    far that moved the finest difference, relative: more than what is left open where the function is smooth."""
    steps = torch.eye(len(at), dtype=at.dtype)
    gradient = [
        (function(at + delta * steps) - function(at - delta * steps)) / (2 * delta)  # errors of order δ², δ⁴, …
        for delta in deltas
    ]
    first, second = ((4 * finer - coarser) / 3 for coarser, finer in pairwise(gradient))
    found = (16 * second - first) / 15
    return found, float((found - gradient[-1]).norm() / found.norm())


def _of_poses(
    mesh: str,
    size: tuple[int, int],
    factor: int,
    part: _Part,
    start: Parameters,
    function: Callable[..., Tensor],
) -> tuple[Tensor, float]:
    """Gradient [n] of the averaged image, and their relative uncertainty."""
    found, uncertainty = [], []
    for times in (factor // 2, factor):
        large = PyrenderRenderer(_scene(mesh, (size[0] * times, size[1] * times)))
        along = _along(large, part, start, partial(function, pooled=times))
        gradient, left = _extrapolated(along, _at(part, start), POSES)
        found.append(gradient)
        uncertainty.append(left)
    coarse, fine = found
    return fine, max(uncertainty[-1], float((fine - coarse).norm() / fine.norm()))


def _pooled(radiance: Tensor, times: int) -> Tensor:
    """Means over squares of `times`² pixels of [B, H, W, C], before anything is displayed."""
    return avg_pool2d(radiance.permute(0, 3, 1, 2), times).permute(0, 2, 3, 1)
