"""Gradients through renderers that have none: the network's gradient in the image, times differences of the image.

With Y(x) the image of the parameters x and f the objective, the chain rule gives

    ∂f/∂x_d = ⟨∂f/∂Y, ∂Y/∂x_d⟩ ≈ ⟨∂f/∂Y, Y(x + δ_d e_d) − Y(x − δ_d e_d)⟩ / 2δ_d.

∂f/∂Y takes one query of the network and one backward pass; the differences take two images per coordinate and no
query. ZOO (`differences`) asks the network about every one of these images. Images are differenced as floats: rounded
to 8 bits most of their change would be lost.
"""

from collections.abc import Mapping
from typing import Any, Self

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from services.attacks import limits
from services.attacks.differences import clamped, inactive, per_batch, steadiest
from services.attacks.problem import AttackProblem, check_graph, quantize
from services.attacks.seeds import draw, generator
from services.rendering.protocol import Parameters

CANDIDATES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4)
"""Half-steps among which `measure_half_steps` chooses."""
PLACES, PROBES = 3, 4
"""Perturbations at which half-steps are compared, and the largest number of coordinates per group at each."""
REACH = 0.03
"""Largest coordinate of these perturbations, in the groups' units."""
PIECE = 2**16
"""Values of each image that are turned into float64 at once."""
NOISE = 4.0
"""Noise floor of a projected difference, in standard deviations of its rounding."""


class ImageDifferences:
    """Central differences of a problem's image, projected on a gradient with respect to the image.

    `half_steps`, float64 [total], are the δ_d in the groups' units. Coordinates in `inactive`, bool [total], changed no
    pixel at the start; they are left out as long as the renderer proves that they still change none.
    """

    def __init__(self, problem: AttackProblem, half_steps: Mapping[str, float]) -> None:
        self.half_steps = problem.layout.spread(half_steps)
        self.skipped = inactive(problem, problem.nothing(), self.half_steps)
        self.inactive = problem.layout.mask((one.group, one.index) for one in self.skipped)
        self.metric: Tensor | None = None
        """∂Yᵀ∂Y per pixel, float64 [total, total], where `project` was last called; None if no method needs it."""

    @classmethod
    def measure(cls, problem: AttackProblem) -> Self:
        """With the half-steps that suit the problem (`measure_half_steps`)."""
        return cls(problem, measure_half_steps(problem))

    @classmethod
    def load(cls, problem: AttackProblem, settings: Mapping[str, Any]) -> Self:
        """With the half-steps that `settings` returned."""
        return cls(problem, settings["delta"])

    def settings(self, problem: AttackProblem) -> dict[str, object]:
        """The half-step of each group, `delta`, and the coordinates left out, `skipped`, as JSON."""
        layout = problem.layout
        delta = {group: float(self.half_steps[layout.starts[group]]) for group in layout.groups}
        return {"delta": delta, "skipped": [{"coordinate": one.name, "why": one.why} for one in self.skipped]}

    def render(self, problem: AttackProblem, perturbation: Parameters) -> Tensor:
        """The image [1, H, W, 3] of a perturbation, with a graph to its tensors whose derivative is by differences."""
        images: Tensor = _Render.apply(self, problem, *(perturbation[g] for g in problem.groups))  # type: ignore[no-untyped-call]
        return images

    @torch.no_grad()
    def project(self, problem: AttackProblem, perturbation: Parameters, gradient: Tensor) -> Parameters:
        """∂f/∂x by group, at a perturbation, from the gradient ∂f/∂Y [H, W, 3]; 0 where inactive or below the noise."""
        layout = problem.layout
        still = self.inactive
        if still.any():
            found = inactive(problem, perturbation, self.half_steps)
            still = still & layout.mask((one.group, one.index) for one in found)
        coordinates = (~(still | limits.fixed(problem.constraint, layout))).nonzero()[:, 0]
        vector = layout.zeros().double()
        steps = self.half_steps[coordinates]
        slopes: list[Tensor] | None = [] if problem.needs_metric else None
        vector[coordinates] = projected(problem, layout.flatten(perturbation), coordinates, steps, gradient, slopes)
        if slopes is not None:
            self.metric = torch.zeros(layout.total, layout.total, dtype=torch.float64)
            self.metric[coordinates[:, None], coordinates] = gram(torch.cat(slopes)) / gradient[..., 0].numel()
        return {g: value.to(perturbation[g].dtype) for g, value in layout.unflatten(vector).items()}


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, differences: ImageDifferences, problem: AttackProblem, *values: Tensor) -> Tensor:
        ctx.differences, ctx.problem, ctx.variation = differences, problem, problem.variation
        ctx.perturbation = {g: value.detach() for g, value in zip(problem.groups, values, strict=True)}
        return problem.render({g: (problem.initial[g] + value)[None] for g, value in ctx.perturbation.items()})

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        with ctx.problem.under(ctx.variation):
            found = ctx.differences.project(ctx.problem, ctx.perturbation, gradient[0])
        return None, None, *(found[group] for group in ctx.problem.groups)


@torch.no_grad()
def projected(
    problem: AttackProblem,
    delta: Tensor,
    coordinates: Tensor,
    half_steps: Tensor,
    gradient: Tensor,
    slopes: list[Tensor] | None = None,
) -> Tensor:
    """⟨g, Y(x + δ_d e_d) − Y(x − δ_d e_d)⟩ / 2δ_d at the coordinates [k], float64 [k]; 0 where below the noise.

    `delta` [total] is the perturbation, `half_steps` [k] are the δ_d in the groups' units, `gradient` g is [H, W, 3]. A
    side that would leave the physical bounds is clamped to them, one that the constraint does not allow is `delta`
    itself, and the difference is divided by the distance that remains. ∂Y/∂x_d, [k, H·W·3] of the images' dtype, are
    appended to `slopes` where it is given. The images are rendered in batches of at most `per_batch`, both sides of a
    coordinate in the same one; an estimate depends on its own two images alone. Raises as `AttackProblem.render` does.

    Rounding moves a value of an image by at most its dtype's machine epsilon. The noise floor is `NOISE` standard
    deviations of ⟨g, rounding of both images⟩, were it uniform and independent from value to value.
    """
    start = problem.layout.flatten(problem.initial)
    weights = gradient.flatten().double()
    noise = NOISE * (2 / 3) ** 0.5 * torch.finfo(problem.original.dtype).eps * float(weights.norm())
    size = max(1, per_batch(problem) // 2)
    found = []
    for chosen, steps in zip(torch.split(coordinates, size), torch.split(half_steps, size), strict=True):
        rows = torch.arange(len(chosen))
        both = delta.repeat(len(chosen), 2, 1)  # [k, 2, total]: the two sides of a difference are neighbours
        both[rows, 0, chosen] += steps.to(both.dtype)
        both[rows, 1, chosen] -= steps.to(both.dtype)
        both = limits.allowed(problem.constraint, problem.layout, clamped(problem, both.flatten(0, 1)), delta)
        images = problem.render(problem.layout.unflatten(start + both))
        moved = (images[0::2] - images[1::2]).flatten(1)
        change = (moved.double() @ weights).cpu()
        width = (both[0::2] - both[1::2])[rows, chosen].double()
        below_noise = (change.abs() <= noise) | (width == 0)
        width = width.where(width != 0, torch.ones_like(width))
        found.append(torch.where(below_noise, 0.0, change / width))
        if slopes is not None:
            slopes.append((moved / width[:, None].to(moved)).cpu())
    return torch.cat(found)


def gram(vectors: Tensor) -> Tensor:
    """Products of each two of the vectors [k, n], float64 [k, k], summed in float64 piece by piece."""
    pieces = (piece.double() for piece in torch.split(vectors, PIECE, dim=1))
    return torch.stack([piece @ piece.T for piece in pieces]).sum(0)


def measure_half_steps(problem: AttackProblem) -> dict[str, float]:
    """Returns for each group the half-step among `CANDIDATES` whose gradients agree best with its neighbours'.

    A step that is too small is dominated by rounding and by the pixels that a silhouette happens to cross, a step that
    is too large by curvature; both show as disagreement with the gradients of the next step (`steadiest`). One place
    would be too few: of three coordinates of a position, two steps that are both too small may agree by chance. All
    changes of the image are projected on the gradient at the original, so that this takes one query.
    """
    layout = problem.layout
    towards, nothing = image_gradient(problem), layout.flatten(problem.nothing())
    random = generator(problem.seed, "image differences")
    offsets = REACH * (2 * torch.rand(PLACES, layout.total, generator=random, dtype=torch.float64) - 1)
    places = limits.projected(problem.constraint, layout, clamped(problem, nothing + offsets.to(nothing.dtype)))
    stays = limits.fixed(problem.constraint, layout)
    chosen = {}
    for group in problem.groups:
        pool = torch.arange(layout.shapes[group].numel()) + layout.starts[group]
        pool = pool[~stays[pool]]
        found = []
        for index, place in enumerate(places):
            probes = draw(pool, PROBES, problem.seed, "image differences", group, index)
            steps = torch.tensor(CANDIDATES, dtype=torch.float64).repeat(len(probes))
            coordinates = probes.repeat_interleave(len(CANDIDATES))
            found.append(projected(problem, place, coordinates, steps, towards).reshape(-1, len(CANDIDATES)))
        chosen[group] = CANDIDATES[steadiest(torch.cat(found))]
    return chosen


def image_gradient(problem: AttackProblem) -> Tensor:
    """∂objective/∂Y [H, W, 3] at the original image, rounded to 8 bits as the loop does. Takes one query."""
    images = problem.original.clone().requires_grad_()
    with torch.enable_grad():
        logits = problem.logits(quantize(images)[1])
        check_graph(problem.renderer, problem.target, images, logits)
        (found,) = torch.autograd.grad(problem.objective(logits[0]), images)
    return found[0]
