"""Central differences: of the objective, for attacks by scores, and of the image, for renderers without gradients.

Either takes both sides of each coordinate of a perturbation. The two images of a coordinate depend on that coordinate
alone, so its estimate is the same whichever others are estimated in the same call.

Of the objective: each image is asked about, and a difference below the noise floor is discarded (`estimate`).

Of the image: with Y(x) the image of the parameters x and f the objective, the chain rule gives

    ∂f/∂x_d = ⟨∂f/∂Y, ∂Y/∂x_d⟩ ≈ ⟨∂f/∂Y, Y(x + δ_d e_d) − Y(x − δ_d e_d)⟩ / 2δ_d.

∂f/∂Y takes one query of the network and one backward pass; the differences take two images per coordinate and no query
(`ImageDifferences`). Images are differenced as floats: rounded to 8 bits most of their change would be lost.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from scene_attack.attacks.problem import AttackProblem, check_graph, draw, quantize
from scene_attack.rendering.protocol import InactiveCoordinate
from scene_attack.rendering.variation import Variation, varied

CANDIDATES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
"""Half-steps among which `measure_half_steps` chooses."""
IMAGE_CANDIDATES = CANDIDATES[:-1]
"""Half-steps among which `measure_image_half_steps` chooses."""
NEARLY = 1.5
"""A half-step counts as steady if its gradients change by at most this factor more than the steadiest half-step's."""
PLACES, PROBES = 3, 4
"""Perturbations at which half-steps of images are compared, and the largest number of coordinates per group at each."""
REACH = 0.03
"""Largest coordinate of these perturbations, in the groups' units."""
PIECE = 2**16
"""Values of each image that are turned into float64 at once."""
NOISE = 4.0
"""Noise floor of a projected difference, in standard deviations of its rounding."""


@dataclass(frozen=True)
class Estimate:
    """Central differences at k coordinates."""

    gradients: Tensor
    """∂objective/∂x, float64 [k]; 0 where `below_noise`."""
    below_noise: Tensor
    """Whether the two values of the objective differ by no more than the noise, bool [k]."""


def estimate(
    problem: AttackProblem, delta: Tensor, coordinates: Tensor, half_steps: Tensor, noise: float, step: int = 0
) -> Estimate:
    """∂objective/∂x_d ≈ (f(x + δ_d e_d) − f(x − δ_d e_d)) / 2δ_d at the coordinates [k] (paper, section 3.2).

    `delta` [total] is the perturbation, `half_steps` [k] are the δ_d in the groups' units, `noise` is the objective's
    noise floor, `step` that of the variations. A side that would leave the box is clamped to it, one that the
    constraint does not allow is `delta` itself, and the difference is divided by the distance that remains. Raises as
    `AttackProblem.objectives` does.
    """
    both = _sides(problem, delta, coordinates, half_steps)
    scores = problem.objectives(both, step).reshape(-1, 2)
    width = _widths(both, coordinates)
    change = scores[:, 0] - scores[:, 1]
    below_noise = (change.abs() <= noise) | (width == 0)
    return Estimate(_quotient(change, width, below_noise), below_noise)


def _sides(problem: AttackProblem, delta: Tensor, coordinates: Tensor, half_steps: Tensor) -> Tensor:
    """Both sides of each coordinate, neighbours in a batch: [2·k, total]."""
    rows = torch.arange(len(coordinates))
    both = delta.repeat(len(coordinates), 2, 1)
    both[rows, 0, coordinates] += half_steps.to(both.dtype)
    both[rows, 1, coordinates] -= half_steps.to(both.dtype)
    return problem.limits.allowed(problem.limits.clamp(both.flatten(0, 1)), delta)


def _widths(both: Tensor, coordinates: Tensor) -> Tensor:
    """The distance between the two sides of each coordinate, float64 [k]."""
    return (both[0::2] - both[1::2])[torch.arange(len(coordinates)), coordinates].double()


def _quotient(change: Tensor, width: Tensor, below_noise: Tensor) -> Tensor:
    return torch.where(below_noise, 0.0, change / width.where(width != 0, torch.ones_like(width)))


@torch.no_grad()
def measure_noise(problem: AttackProblem, delta: Tensor) -> float:
    """Noise floor of the objective at the perturbation `delta` [total]: its spread under floating-point rounding.

    The image is jittered eight times by at most the machine epsilon of its dtype. The noise floor is twice the
    range of the objective over these images.
    """
    random = problem.generator("noise")
    image = problem.render(delta[None])
    scores = []
    for _ in range(8):
        jitter = torch.rand(image.shape, generator=random, dtype=image.dtype).to(image.device) - 0.5
        jittered = image + 2 * torch.finfo(image.dtype).eps * jitter
        scores.append(problem.advantages(jittered) + problem.penalty(jittered))
    values = torch.cat(scores)
    return 2 * float(values.max() - values.min())


def measure_half_steps(problem: AttackProblem, reach: Tensor, noise: float, probes: int = 4) -> dict[str, float]:
    """Returns for each group the half-step among `CANDIDATES` whose gradients agree best with its neighbours'.

    A step that is too small is dominated by rounding and by pixels at silhouettes, a step that is too large by
    curvature; both show as disagreement with the gradients of the next step. Gradients are estimated at `probes` random
    coordinates per group, at a perturbation of random signs times `reach` [total], in the groups' units. At the
    perturbation 0 the λ term would be symmetric: every step would cancel it, and far too large steps would look steady.
    A group whose differences are all below `noise` gets the largest step.
    """
    layout, limits = problem.layout, problem.limits
    signs = torch.randint(0, 2, (layout.total,), generator=problem.generator("reach"))
    [at] = limits.project(limits.clamp(((2 * signs - 1) * reach)[None]))
    fixed = limits.fixed
    chosen = {}
    for group in layout.groups:
        count = layout.shapes[group].numel()
        order = torch.randperm(count, generator=problem.generator("deltas", group))
        order = order[~fixed[layout.starts[group] + order]][: min(probes, count)]
        coordinates = (order + layout.starts[group]).repeat_interleave(len(CANDIDATES))
        steps = torch.tensor(CANDIDATES, dtype=torch.float64).repeat(len(order))
        gradients = estimate(problem, at, coordinates, steps, noise).gradients
        chosen[group] = CANDIDATES[steadiest(gradients.reshape(len(order), len(CANDIDATES)))]
    return chosen


def steadiest(gradients: Tensor) -> int:
    """Index of a candidate, given gradients [probes, candidates], largest step first; 0 if all are below the noise.

    A candidate is compared with both neighbours, so only inner candidates can be chosen. The largest step is taken
    among those nearly as steady as the steadiest: two small steps may agree by chance on noise, two large ones hardly.
    """
    size = gradients.norm(dim=0)
    gap = (gradients[:, 1:] - gradients[:, :-1]).norm(dim=0) / torch.maximum(size[1:], size[:-1])
    gap = gap.nan_to_num(nan=float("inf"))  # 0/0: below the noise on both sides
    inner = torch.maximum(gap[1:], gap[:-1])
    if bool(inner.isinf().all()):
        return 0
    return 1 + int((inner <= NEARLY * inner.min()).nonzero()[0])


def inactive(
    problem: AttackProblem, delta: Tensor, half_steps: Tensor, variations: Sequence[Variation | None] = (None,)
) -> list[InactiveCoordinate]:
    """The attacked coordinates that change no pixel at a perturbation [total] when moved by their group's half-step,
    under any of the variations; None is the scene itself.

    `half_steps` [total] has one value per group, in the groups' units.
    """
    layout = problem.layout
    reach = {group: float(half_steps[layout.starts[group]]) for group in layout.groups}
    at = layout.unflatten(problem.initial + delta)
    by_variation = []
    for variation in variations:
        there = at
        if variation is not None:
            moved = varied(problem.renderer, {group: value[None] for group, value in at.items()}, variation)
            there = {group: value[0] for group, value in moved.items()}
        by_variation.append(
            {coordinate for coordinate in problem.renderer.inactive(there, reach) if coordinate.group in layout.groups}
        )
    return sorted(
        set.intersection(*by_variation), key=lambda coordinate: layout.starts[coordinate.group] + coordinate.index
    )


def inactive_mask(
    problem: AttackProblem, delta: Tensor, half_steps: Tensor, variations: Sequence[Variation | None] = (None,)
) -> Tensor:
    """The coordinates of `inactive` as a mask, bool [total]."""
    coordinates = inactive(problem, delta, half_steps, variations)
    return problem.layout.mask((coordinate.group, coordinate.index) for coordinate in coordinates)


def active(
    problem: AttackProblem,
    delta: Tensor,
    inactive_at_start: Tensor,
    half_steps: Tensor,
    variations: Sequence[Variation | None] = (None,),
) -> Tensor:
    """The coordinates to difference at a perturbation [total]: all but those that the constraint fixes, and those
    inactive at the start, a mask, bool [total], that still are. Most scenes have none.
    """
    still = inactive_at_start
    if still.any():
        still = still & inactive_mask(problem, delta, half_steps, variations)
    return (~(still | problem.limits.fixed)).nonzero()[:, 0]


def settings_of(
    problem: AttackProblem, half_steps: Tensor, variations: Sequence[Variation | None] = (None,)
) -> dict[str, object]:
    """Returns the settings of the differences, as JSON: the half-step of each group, `delta`, and the coordinates that
    are inactive at the start, `skipped`, with the reasons.
    """
    layout = problem.layout
    coordinates = inactive(problem, problem.nothing, half_steps, variations)
    return {
        "delta": {group: float(half_steps[layout.starts[group]]) for group in layout.groups},
        "skipped": [{"coordinate": coordinate.name, "why": coordinate.why} for coordinate in coordinates],
    }


# Of the image


@dataclass(frozen=True)
class ImageDifferences:
    """Central differences of a problem's image, projected on a gradient with respect to the image."""

    half_steps: Tensor
    """δ_d in the groups' units, float64 [total]."""
    inactive: Tensor
    """Coordinates that changed no pixel at the start, bool [total]. They are left out as long as the renderer proves
    that they still change none."""
    keeps_metric: bool = False
    """Whether `project` returns the metric too."""

    @classmethod
    def at(cls, problem: AttackProblem, half_steps: dict[str, float] | Tensor, *, keeps_metric: bool = False) -> Self:
        """With these half-steps, by group or [total]."""
        steps = half_steps if isinstance(half_steps, Tensor) else problem.layout.spread(half_steps)
        return cls(steps, inactive_mask(problem, problem.nothing, steps), keeps_metric)

    @classmethod
    def measure(cls, problem: AttackProblem, *, keeps_metric: bool = False) -> Self:
        """With the half-steps that suit the problem (`measure_image_half_steps`)."""
        return cls.at(problem, measure_image_half_steps(problem), keeps_metric=keeps_metric)

    def settings(self, problem: AttackProblem) -> dict[str, object]:
        """See `settings_of`."""
        return settings_of(problem, self.half_steps)

    @torch.no_grad()
    def project(
        self, problem: AttackProblem, delta: Tensor, gradient: Tensor, step: int, variation: Variation | None
    ) -> tuple[Tensor, Tensor | None]:
        """∂f/∂x [total] at a perturbation, from the gradient ∂f/∂Y [H, W, 3] of its image under a variation; 0 where
        inactive or below the noise. Also the metric ∂Yᵀ∂Y per pixel, float64 [total, total], or None.
        """
        layout = problem.layout
        looked = (None, *problem.variations(step)) if variation is None else (variation,)
        coordinates = active(problem, delta, self.inactive, self.half_steps, looked)
        vector = layout.zeros().double()
        slopes: list[Tensor] | None = [] if self.keeps_metric else None
        steps = self.half_steps[coordinates]
        vector[coordinates] = projected(problem, delta, coordinates, steps, gradient, variation, slopes)
        if slopes is None:
            return vector.to(delta.dtype), None
        metric = torch.zeros(layout.total, layout.total, dtype=torch.float64)
        metric[coordinates[:, None], coordinates] = gram(torch.cat(slopes)) / gradient[..., 0].numel()
        return vector.to(delta.dtype), metric


@torch.no_grad()
def projected(
    problem: AttackProblem,
    delta: Tensor,
    coordinates: Tensor,
    half_steps: Tensor,
    gradient: Tensor,
    variation: Variation | None = None,
    slopes: list[Tensor] | None = None,
) -> Tensor:
    """⟨g, Y(x + δ_d e_d) − Y(x − δ_d e_d)⟩ / 2δ_d at the coordinates [k], float64 [k]; 0 where below the noise.

    `delta` [total] is the perturbation, `half_steps` [k] are the δ_d in the groups' units, `gradient` g is [H, W, 3]. A
    side that would leave the box is clamped to it, one that the constraint does not allow is `delta` itself, and the
    difference is divided by the distance that remains. ∂Y/∂x_d, [k, H·W·3] of the images' dtype, are appended to
    `slopes` where it is given. The images are rendered in batches, both sides of a coordinate in the same one; an
    estimate depends on its own two images alone. Raises as `AttackProblem.render` does.

    Rounding moves a value of an image by at most its dtype's machine epsilon. The noise floor is `NOISE` standard
    deviations of ⟨g, rounding of both images⟩, were it uniform and independent from value to value.
    """
    weights = gradient.flatten().double()
    noise = NOISE * (2 / 3) ** 0.5 * torch.finfo(problem.original.dtype).eps * float(weights.norm())
    size = max(1, problem.per_batch // 2)
    gradients = []
    for chosen, steps in zip(torch.split(coordinates, size), torch.split(half_steps, size), strict=True):
        both = _sides(problem, delta, chosen, steps)
        images = problem.render(both, variation)
        moved = (images[0::2] - images[1::2]).flatten(1)
        change, width = (moved.double() @ weights).cpu(), _widths(both, chosen)
        below_noise = (change.abs() <= noise) | (width == 0)
        gradients.append(_quotient(change, width, below_noise))
        if slopes is not None:
            divisor = width.where(width != 0, torch.ones_like(width))
            slopes.append((moved / divisor[:, None].to(moved)).cpu())
    return torch.cat(gradients)


def gram(vectors: Tensor) -> Tensor:
    """Products of each two of the vectors [k, n], float64 [k, k], summed in float64 piece by piece."""
    pieces = (piece.double() for piece in torch.split(vectors, PIECE, dim=1))
    return torch.stack([piece @ piece.T for piece in pieces]).sum(0)


def measure_image_half_steps(problem: AttackProblem) -> dict[str, float]:
    """Returns for each group the half-step among `IMAGE_CANDIDATES` whose gradients agree best with its neighbours'.

    A step that is too small is dominated by rounding and by the pixels that a silhouette happens to cross, a step that
    is too large by curvature; both show as disagreement with the gradients of the next step (`steadiest`). One place
    would be too few: of three coordinates of a position, two steps that are both too small may agree by chance. All
    changes of the image are projected on the gradient at the original, so that this takes one query.
    """
    layout, limits, nothing = problem.layout, problem.limits, problem.nothing
    towards = image_gradient(problem)
    random = problem.generator("image differences")
    offsets = REACH * (2 * torch.rand(PLACES, layout.total, generator=random, dtype=torch.float64) - 1)
    places = limits.project(limits.clamp(nothing + offsets.to(nothing.dtype)))
    fixed = limits.fixed
    chosen = {}
    for group in layout.groups:
        pool = torch.arange(layout.shapes[group].numel()) + layout.starts[group]
        pool = pool[~fixed[pool]]
        gradients = []
        for index, place in enumerate(places):
            probes = draw(pool, PROBES, problem.seed, "image differences", group, index)
            steps = torch.tensor(IMAGE_CANDIDATES, dtype=torch.float64).repeat(len(probes))
            coordinates = probes.repeat_interleave(len(IMAGE_CANDIDATES))
            gradients.append(projected(problem, place, coordinates, steps, towards).reshape(-1, len(IMAGE_CANDIDATES)))
        chosen[group] = IMAGE_CANDIDATES[steadiest(torch.cat(gradients))]
    return chosen


def image_gradient(problem: AttackProblem) -> Tensor:
    """∂objective/∂Y [H, W, 3] at the original image, rounded to 8 bits as the loop does. Takes one query."""
    images = problem.original.clone().requires_grad_()
    with torch.enable_grad():
        scores = problem.scores(quantize(images)[1])
        check_graph(problem.renderer, problem.target, images, scores)
        (gradient,) = torch.autograd.grad(problem.objective(scores[0]), images)
    return gradient[0]
