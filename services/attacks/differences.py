"""Central differences of the objective, coordinate by coordinate, and the noise they have to beat.

All attacked groups are one vector here, group after group (`layout`). Each coordinate's two images depend on nothing
but that coordinate, so an estimate is the same whatever else is differenced beside it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from services.attacks.problem import AttackProblem, distances, truncate
from services.attacks.seeds import generator

CHUNK_VALUES = 8_000_000
"""Values (pixels × channels) rendered at a time: about 100 MB with the network's activations beside it."""
NEARLY = 1.5
"""A candidate is as steady as the steadiest if it changes by at most this factor more."""
CANDIDATES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
"""Half-steps among which `measure_half_steps` chooses."""


def objective(problem: AttackProblem, images: Tensor) -> Tensor:
    """The hinge-free objective of ZOO, [B] float64: log-probability advantage + λ·‖ΔY‖².

    Each image is scored alone: the sums run over its own pixels, never over the batch.
    """
    advantage = problem.goal.advantage(problem.logits(images)).double()
    if problem.weight == 0:
        return advantage
    return advantage + problem.weight * distances(images, problem.original).square()


@torch.no_grad()
def evaluate(problem: AttackProblem, vectors: Tensor) -> Tensor:
    """The objective at perturbations [B, total], [B] float64 on the CPU, in chunks of bounded memory."""
    height, width = problem.renderer.size
    size = max(1, min(28, CHUNK_VALUES // (height * width * 3)))
    start = problem.layout.flatten(problem.initial)
    scores = []
    for chunk in torch.split(vectors, size):
        images = problem.render(problem.layout.unflatten(start + chunk))
        if problem.truncation is not None:
            images = torch.cat([truncate(image[None], problem.original, problem.truncation)[0] for image in images])
        scores.append(objective(problem, images).cpu())
    return torch.cat(scores)


@dataclass(frozen=True)
class Estimate:
    """Central differences. `below_noise` marks those whose two values differ by less than the noise; there the gradient
    is 0.
    """

    gradients: Tensor
    below_noise: Tensor


def estimate(problem: AttackProblem, delta: Tensor, coordinates: Tensor, half_steps: Tensor, noise: float) -> Estimate:
    """∂objective/∂x_d ≈ (f(x + δ_d e_d) − f(x − δ_d e_d)) / 2δ_d at the coordinates [k] (paper, section 3.2).

    `delta` [total] is the perturbation; `half_steps` [k] are the δ_d. Where a side would leave the physical bounds it
    stops there, and the true distance divides.
    """
    rows = torch.arange(len(coordinates))
    sides = []
    for sign in (1.0, -1.0):
        moved = delta.repeat(len(coordinates), 1)
        moved[rows, coordinates] += sign * half_steps.to(moved.dtype)
        sides.append(clamped(problem, moved))
    both = torch.stack(sides, dim=1)  # [k, 2, total]: the two sides of a difference are neighbours
    scores = evaluate(problem, both.flatten(0, 1)).reshape(-1, 2)
    width = (both[rows, 0, coordinates] - both[rows, 1, coordinates]).double()
    change = scores[:, 0] - scores[:, 1]
    below_noise = (change.abs() <= noise) | (width == 0)
    gradients = torch.where(below_noise, 0.0, change / width.where(width != 0, torch.ones_like(width)))
    return Estimate(gradients, below_noise)


def clamped(problem: AttackProblem, vectors: Tensor) -> Tensor:
    """Perturbations [B, total] pulled back into the physical bounds."""
    within = problem.clamp(problem.layout.unflatten(vectors))
    return torch.cat([within[g].flatten(1) for g in problem.layout.groups], dim=1)


def measure_noise(problem: AttackProblem, delta: Tensor, samples: int = 8) -> float:
    """Noise floor of the objective at the perturbation `delta` [total]: its spread under floating-point rounding.

    Images are jittered by one unit in the last place at 1, of their own dtype; twice the range seen is called noise.
    """
    layout = problem.layout
    random = generator(problem.seed, "noise")
    with torch.no_grad():
        image = problem.render(layout.unflatten((layout.flatten(problem.initial) + delta)[None]))
        scores = []
        for _ in range(samples):
            jitter = torch.rand(image.shape, generator=random, dtype=image.dtype).to(image.device) - 0.5
            scores.append(objective(problem, image + 2 * torch.finfo(image.dtype).eps * jitter))
    values = torch.cat(scores)
    return 2 * float(values.max() - values.min())


def measure_half_steps(problem: AttackProblem, reach: Tensor, noise: float, probes: int = 4) -> dict[str, float]:
    """For each group the half-step whose gradients agree best with those of the neighbouring half-steps.

    Too small a step drowns in rounding and in the pixels of an edge, too large a one sees curvature; both show as
    disagreement with the next step. Gradients are probed at a few random coordinates of the perturbation ±`reach`
    [total]: at zero the λ term is symmetric, any step cancels it, and the far too large ones look steady. Where all are
    below the noise, the largest step is taken.
    """
    layout = problem.layout
    signs = torch.randint(0, 2, (layout.total,), generator=generator(problem.seed, "reach"))
    at = clamped(problem, ((2 * signs - 1) * reach)[None])[0]
    chosen = {}
    for group in problem.groups:
        count = layout.shapes[group].numel()
        order = torch.randperm(count, generator=generator(problem.seed, "deltas", group))[: min(probes, count)]
        coordinates = (order + layout.starts[group]).repeat_interleave(len(CANDIDATES))
        steps = torch.tensor(CANDIDATES, dtype=torch.float64).repeat(len(order))
        gradients = estimate(problem, at, coordinates, steps, noise).gradients
        chosen[group] = CANDIDATES[_steadiest(gradients.reshape(len(order), len(CANDIDATES)))]
    return chosen


def _steadiest(gradients: Tensor) -> int:
    """Index of a candidate, given gradients [probes, candidates], largest step first; 0 if all are below the noise.

    The change towards both neighbours is what counts, so only inner candidates can win. Among those nearly as steady as
    the steadiest the largest step is taken: by chance two small steps may agree on noise, two large ones hardly do.
    """
    size = gradients.norm(dim=0)
    gap = (gradients[:, 1:] - gradients[:, :-1]).norm(dim=0) / torch.maximum(size[1:], size[:-1])
    gap = gap.nan_to_num(nan=float("inf"))  # 0/0: below the noise on both sides
    inner = torch.maximum(gap[1:], gap[:-1])
    if bool(inner.isinf().all()):
        return 0
    return 1 + int((inner <= NEARLY * inner.min()).nonzero()[0])
