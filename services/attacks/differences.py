"""Central differences of the objective, coordinate by coordinate, and the noise they have to beat.

All attacked groups are one flat vector here, group after group. Each coordinate's two pictures depend on nothing but
that coordinate, so an estimate is the same whatever else is differenced beside it.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from services.attacks.problem import AttackProblem, distances, truncate
from services.attacks.seeds import generator
from services.rendering.protocol import Parameters

CHUNK_VALUES = 8_000_000
"""Values (pixels × channels) rendered at a time: about 100 MB with the network's activations beside it."""
NEARLY = 1.5
CANDIDATES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
"""Half-steps among which `measure_deltas` chooses."""


@dataclass(frozen=True)
class Layout:
    """Where each group's coordinates are in the flat vector."""

    groups: tuple[str, ...]
    shapes: dict[str, torch.Size]
    starts: dict[str, int]
    total: int

    def group_of(self, coordinate: int) -> str:
        """The group a flat coordinate belongs to."""
        return next(g for g in reversed(self.groups) if coordinate >= self.starts[g])

    def flatten(self, parameters: Parameters) -> Tensor:
        """One vector of all groups."""
        return torch.cat([parameters[g].flatten() for g in self.groups])

    def unflatten(self, vectors: Tensor) -> Parameters:
        """Vectors [..., total] as groups [..., shape]."""
        lead = vectors.shape[:-1]
        return {
            g: vectors[..., self.starts[g] : self.starts[g] + self.shapes[g].numel()].reshape(*lead, *self.shapes[g])
            for g in self.groups
        }


def layout(problem: AttackProblem) -> Layout:
    """The layout of a problem's attacked groups."""
    starts, total = {}, 0
    for group in problem.groups:
        starts[group] = total
        total += problem.initial[group].numel()
    return Layout(problem.groups, {g: v.shape for g, v in problem.initial.items()}, starts, total)


def objective(problem: AttackProblem, images: Tensor) -> Tensor:
    """The hinge-free objective of ZOO, [B] float64: log-probability advantage + λ·‖ΔY‖².

    Each picture is scored alone: the sums run over its own pixels, never over the batch.
    """
    advantage = problem.goal.advantage(problem.logits(images)).double()
    if problem.weight == 0:
        return advantage
    return advantage + problem.weight * distances(images, problem.original).square()


@torch.no_grad()
def evaluate(problem: AttackProblem, vectors: Tensor, where: Layout) -> Tensor:
    """The objective at perturbations [B, total], [B] float64, rendered and asked in chunks of bounded memory."""
    height, width = problem.renderer.size
    size = max(1, min(28, CHUNK_VALUES // (height * width * 3)))
    start = where.flatten(problem.initial)
    scores = []
    for chunk in torch.split(vectors, size):
        images = problem.render(where.unflatten(start + chunk))
        if problem.truncation is not None:
            images = torch.cat([truncate(image[None], problem.original, problem.truncation)[0] for image in images])
        scores.append(objective(problem, images))
    return torch.cat(scores)


@dataclass(frozen=True)
class Estimate:
    """Central differences. `flat` marks those whose two values differ by less than the noise; their slope is 0."""

    slopes: Tensor
    flat: Tensor


def estimate(
    problem: AttackProblem, perturbation: Tensor, coordinates: Tensor, deltas: Tensor, noise: float
) -> Estimate:
    """∂objective/∂x_d ≈ (f(x + δ_d e_d) − f(x − δ_d e_d)) / 2δ_d at the flat coordinates [k] (paper, section 3.2).

    Where a side would leave the physical bounds it stops there, and the true distance divides. `deltas` [k].
    """
    where = layout(problem)
    rows = torch.arange(len(coordinates))
    sides = []
    for sign in (1.0, -1.0):
        moved = perturbation.repeat(len(coordinates), 1)
        moved[rows, coordinates] += sign * deltas.to(moved.dtype)
        sides.append(where_clamped(problem, moved, where))
    both = torch.stack(sides, dim=1)  # [k, 2, total]: the two sides of a difference are neighbours
    scores = evaluate(problem, both.flatten(0, 1), where).reshape(-1, 2)
    width = (both[rows, 0, coordinates] - both[rows, 1, coordinates]).double()
    change = scores[:, 0] - scores[:, 1]
    flat = (change.abs() <= noise) | (width == 0)
    slopes = torch.where(flat, 0.0, change / width.where(width != 0, torch.ones_like(width)))
    return Estimate(slopes, flat)


def where_clamped(problem: AttackProblem, vectors: Tensor, where: Layout) -> Tensor:
    """Perturbations [B, total] pulled back into the physical bounds."""
    clamped = problem.clamp(where.unflatten(vectors))
    return torch.cat([clamped[g].flatten(1) for g in where.groups], dim=1)


def measure_noise(problem: AttackProblem, perturbation: Tensor, samples: int = 8) -> float:
    """How much the objective moves when nothing does: the spread under changes of the picture by float rounding.

    Pictures are jittered by one unit in the last place at 1, of their own dtype; twice the range seen is called noise.
    """
    where = layout(problem)
    random = generator(problem.seed, "noise")
    with torch.no_grad():
        picture = problem.render(where.unflatten((where.flatten(problem.initial) + perturbation)[None]))
        scores = []
        for _ in range(samples):
            jitter = torch.rand(picture.shape, generator=random, dtype=picture.dtype) - 0.5
            scores.append(objective(problem, picture + 2 * torch.finfo(picture.dtype).eps * jitter))
    values = torch.cat(scores)
    return 2 * float(values.max() - values.min())


def measure_deltas(problem: AttackProblem, reach: Tensor, noise: float, probes: int = 4) -> dict[str, float]:
    """For each group the half-step whose slopes agree best with those of the neighbouring half-steps.

    Too small a step drowns in rounding and in the pixels of an edge, too large a one sees curvature; both show as
    disagreement with the next step. Slopes are probed at a few random coordinates of the perturbation ±`reach` [total]:
    at zero the λ term is symmetric, any step cancels it, and the far too large ones look steady. Where all is flat, the
    largest step is taken.
    """
    where = layout(problem)
    signs = torch.randint(0, 2, (where.total,), generator=generator(problem.seed, "reach"))
    at = where_clamped(problem, ((2 * signs - 1) * reach)[None], where)[0]
    chosen = {}
    for group in problem.groups:
        count = where.shapes[group].numel()
        order = torch.randperm(count, generator=generator(problem.seed, "deltas", group))[: min(probes, count)]
        coordinates = (order + where.starts[group]).repeat_interleave(len(CANDIDATES))
        steps = torch.tensor(CANDIDATES, dtype=torch.float64).repeat(len(order))
        slopes = estimate(problem, at, coordinates, steps, noise).slopes
        chosen[group] = CANDIDATES[_steadiest(slopes.reshape(len(order), len(CANDIDATES)))]
    return chosen


def _steadiest(slopes: Tensor) -> int:
    """Which candidate, given slopes [probes, candidates], largest step first; 0 if all are flat.

    The change towards both neighbours is what counts, so only inner candidates can win. Among those nearly as steady as
    the steadiest the largest step is taken: by chance two small steps may agree on noise, two large ones hardly do.
    """
    size = slopes.norm(dim=0)
    gap = (slopes[:, 1:] - slopes[:, :-1]).norm(dim=0) / torch.maximum(size[1:], size[:-1])
    gap = gap.nan_to_num(nan=float("inf"))  # 0/0: flat on both sides
    inner = torch.maximum(gap[1:], gap[:-1])
    if bool(inner.isinf().all()):
        return 0
    return 1 + int((inner <= NEARLY * inner.min()).nonzero()[0])
