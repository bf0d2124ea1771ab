"""Central differences of the objective, coordinate by coordinate, and the noise floor below which they are discarded.

All attacked groups form one vector here, group after group (`layout`). The two images of a coordinate depend on that
coordinate alone, so its estimate is the same whichever other coordinates are estimated in the same call.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from services.attacks.limits import allowed, fixed, projected
from services.attacks.problem import AttackProblem, distances, truncate
from services.attacks.seeds import generator
from services.rendering.protocol import InactiveCoordinate, Parameters
from services.rendering.variation import varied

CHUNK_VALUES = 8_000_000
"""Largest number of values (pixels × channels) rendered in one batch; with the network's activations about 100 MB."""
MAX_BATCH = 28
"""Largest number of images rendered in one batch: both sides of the paper's 14 coordinates."""
NEARLY = 1.5
"""A half-step counts as steady if its gradients change by at most this factor more than the steadiest half-step's."""
CANDIDATES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
"""Half-steps among which `measure_half_steps` chooses."""


def objective(problem: AttackProblem, images: Tensor) -> Tensor:
    """The hinge-free objective of ZOO, [B] float64: log-probability advantage + λ·‖ΔY‖².

    `images` is [B, H, W, 3] in [0,1]. The sums run over the pixels of each image, never over the batch.
    """
    return _advantage(problem, images) + penalty(problem, images)


def _advantage(problem: AttackProblem, images: Tensor) -> Tensor:
    return problem.goal.advantage(problem.logits(images)).double()


def penalty(problem: AttackProblem, images: Tensor) -> Tensor | float:
    """λ‖ΔY‖² of images [B, H, W, 3], float64 [B]; 0 without λ."""
    return 0.0 if problem.weight == 0 else problem.weight * distances(images, problem.original).square()


def per_batch(problem: AttackProblem) -> int:
    """The number of images rendered in one batch: at most `MAX_BATCH`, of at most `CHUNK_VALUES` values, at least 1."""
    height, width = problem.renderer.size
    return max(1, min(MAX_BATCH, CHUNK_VALUES // (height * width * 3)))


@torch.no_grad()
def evaluate(problem: AttackProblem, vectors: Tensor) -> Tensor:
    """The objective at the perturbations `vectors` [B, total]: [B] float64 on the CPU.

    With variations the advantage is the mean over the scene itself and them; λ weighs the change of the scene itself.
    Images are rendered in chunks of at most `CHUNK_VALUES` values. Raises as `AttackProblem.render` and `logits` do.
    """
    start = problem.layout.flatten(problem.initial)
    scores = []
    for chunk in torch.split(vectors, per_batch(problem)):
        parameters = problem.layout.unflatten(start + chunk)
        images = problem.render(parameters)
        if problem.truncation is not None:
            images = torch.cat([truncate(image[None], problem.original, problem.truncation)[0] for image in images])
        advantages = [_advantage(problem, images)]
        for variation in problem.variations:
            with problem.under(variation):
                advantages.append(_advantage(problem, problem.render(parameters)))
        scores.append((torch.stack(advantages).mean(dim=0) + penalty(problem, images)).cpu())
    return torch.cat(scores)


@dataclass(frozen=True)
class Estimate:
    """Central differences at k coordinates."""

    gradients: Tensor
    """∂objective/∂x, float64 [k]; 0 where `below_noise`."""
    below_noise: Tensor
    """Whether the two values of the objective differ by no more than the noise, bool [k]."""


def estimate(problem: AttackProblem, delta: Tensor, coordinates: Tensor, half_steps: Tensor, noise: float) -> Estimate:
    """∂objective/∂x_d ≈ (f(x + δ_d e_d) − f(x − δ_d e_d)) / 2δ_d at the coordinates [k] (paper, section 3.2).

    `delta` [total] is the perturbation, `half_steps` [k] are the δ_d in the groups' units, `noise` is the objective's
    noise floor. A side that would leave the physical bounds is clamped to them, one that the constraint does not allow
    is `delta` itself, and the difference is divided by the distance that remains. Raises as `evaluate` does.
    """
    rows = torch.arange(len(coordinates))
    sides = []
    for sign in (1.0, -1.0):
        moved = delta.repeat(len(coordinates), 1)
        moved[rows, coordinates] += sign * half_steps.to(moved.dtype)
        sides.append(allowed(problem.constraint, problem.layout, clamped(problem, moved), delta))
    both = torch.stack(sides, dim=1)  # [k, 2, total]: the two sides of a difference are neighbours
    scores = evaluate(problem, both.flatten(0, 1)).reshape(-1, 2)
    width = (both[rows, 0, coordinates] - both[rows, 1, coordinates]).double()
    change = scores[:, 0] - scores[:, 1]
    below_noise = (change.abs() <= noise) | (width == 0)
    gradients = torch.where(below_noise, 0.0, change / width.where(width != 0, torch.ones_like(width)))
    return Estimate(gradients, below_noise)


def clamped(problem: AttackProblem, vectors: Tensor) -> Tensor:
    """Perturbations [B, total], clamped so that the perturbed parameters are within the renderer's physical bounds."""
    within = problem.clamp(problem.layout.unflatten(vectors))
    return torch.cat([within[g].flatten(1) for g in problem.layout.groups], dim=1)


def moved(problem: AttackProblem, at: Tensor, changes: Tensor) -> Tensor:
    """The perturbation `at` [total] moved by each of `changes`, float64 [B, total], and clamped: [B, total]."""
    return clamped(problem, (at.double() + changes).to(at.dtype))


def measure_noise(problem: AttackProblem, delta: Tensor, samples: int = 8) -> float:
    """Noise floor of the objective at the perturbation `delta` [total]: its spread under floating-point rounding.

    The image is jittered `samples` times by at most the machine epsilon of its dtype. The noise floor is twice the
    range of the objective over these images.
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
    """Returns for each group the half-step among `CANDIDATES` whose gradients agree best with its neighbours'.

    A step that is too small is dominated by rounding and by pixels at silhouettes, a step that is too large by
    curvature; both show as disagreement with the gradients of the next step. Gradients are estimated at `probes` random
    coordinates per group, at a perturbation of random signs times `reach` [total], in the groups' units. At the
    perturbation 0 the λ term would be symmetric: every step would cancel it, and far too large steps would look steady.
    A group whose differences are all below `noise` gets the largest step.
    """
    layout = problem.layout
    signs = torch.randint(0, 2, (layout.total,), generator=generator(problem.seed, "reach"))
    [at] = projected(problem.constraint, layout, clamped(problem, ((2 * signs - 1) * reach)[None]))
    stays = fixed(problem.constraint, layout)
    chosen = {}
    for group in problem.groups:
        count = layout.shapes[group].numel()
        order = torch.randperm(count, generator=generator(problem.seed, "deltas", group))
        order = order[~stays[layout.starts[group] + order]][: min(probes, count)]
        coordinates = (order + layout.starts[group]).repeat_interleave(len(CANDIDATES))
        steps = torch.tensor(CANDIDATES, dtype=torch.float64).repeat(len(order))
        gradients = estimate(problem, at, coordinates, steps, noise).gradients
        chosen[group] = CANDIDATES[steadiest(gradients.reshape(len(order), len(CANDIDATES)))]
    return chosen


def inactive(problem: AttackProblem, perturbation: Parameters, half_steps: Tensor) -> list[InactiveCoordinate]:
    """The attacked coordinates that change no pixel at `perturbation` when moved by their group's half-step, under the
    present variation, or else neither in the scene itself nor under any variation of the step.

    `half_steps` [total] has one value per group, in the groups' units.
    """
    layout = problem.layout
    reach = {group: float(half_steps[layout.starts[group]]) for group in layout.groups}
    at = {group: problem.initial[group] + value for group, value in perturbation.items()}
    found = []
    for variation in (None, *problem.variations) if problem.variation is None else (problem.variation,):
        there = at
        if variation is not None:
            moved = varied(problem.renderer, {group: value[None] for group, value in at.items()}, variation)
            there = {group: value[0] for group, value in moved.items()}
        found.append({one for one in problem.renderer.inactive(there, reach) if one.group in layout.groups})
    return sorted(set.intersection(*found), key=lambda one: layout.starts[one.group] + one.index)


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
