"""Problem of an attack: the parameters that may change, the loss, and the evaluation of a perturbation.

Images are rounded to 8 bits with a straight-through derivative, so that an attack sees the image that is saved. What
renderers, networks and attacks return is checked here: a plug-in that breaks its protocol must end its job with a
reason. Unchecked, most of what it may return is a result: values beyond [0,1] are clipped when the image is saved, and
scores that are no numbers have a largest one too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import nan, radians
from typing import Any, Protocol

import torch
from torch import Tensor

from scene_attack.attacks.goal import ResolvedGoal, loss
from scene_attack.attacks.limits import Layout, Limits, pulled_back
from scene_attack.attacks.request import Expectation, Loss
from scene_attack.errors import JobFailure, named
from scene_attack.process import finite
from scene_attack.rendering import color
from scene_attack.rendering.protocol import BOUND_SLACK, Renderer
from scene_attack.rendering.sensor.settings import DRAWS, PLAIN, Sensor, SensorRange
from scene_attack.rendering.variation import Variation, taken, varied
from scene_attack.targets.protocol import Target

CHUNK_VALUES = 8_000_000
"""Largest number of values (pixels × channels) rendered in one batch; with the network's activations about 100 MB."""
MAX_BATCH = 28
"""Largest number of images rendered in one batch: both sides of the paper's 14 coordinates."""
SLACK = 1e-4
"""Largest excess of a displayed value beyond [0,1] by rounding; a fortieth of a step of an 8-bit image."""


@dataclass
class Counts:
    """Images so far: `renders` rendered, `queries` classified by the network, `surrogate_queries` by a surrogate."""

    queries: int = 0
    renders: int = 0
    surrogate_queries: int = 0


@dataclass(frozen=True)
class Surrogate:
    """Another network, whose gradients guide the search against a network that gives scores only, and the attack's
    goal in its own labels.
    """

    target: Target
    goal: ResolvedGoal


class Differences(Protocol):
    """Derivatives of images for a renderer that has none (`differences.ImageDifferences`)."""

    def project(
        self, problem: AttackProblem, delta: Tensor, gradient: Tensor, step: int, variation: Variation | None
    ) -> tuple[Tensor, Tensor | None]:
        """∂f/∂delta [total] from the gradient ∂f/∂Y [H, W, 3] of the image of `delta`, and the metric if it is kept."""
        ...

    def settings(self, problem: AttackProblem) -> dict[str, object]:
        """Settings of the differences, as JSON."""
        ...


@dataclass(frozen=True)
class Evaluation:
    """A perturbation and how it looks to the network, of the scene itself or under one variation of it."""

    step: int
    """Number of the step within its start, from 0."""
    delta: Tensor
    """The perturbation [total] that was looked at; backtracking may have made it shorter than the attack's."""
    rendered: Tensor
    """The image [1, H, W, 3] in [0,1] before it is truncated."""
    image: Tensor
    """The image truncated to U around the original, [1, H, W, 3]."""
    truncated: Tensor
    """Pixels with a truncated value, bool [H, W]."""
    saved: Tensor
    """The image rounded to 8 bits, uint8 [H, W, 3]."""
    scores: Tensor
    """The network's scores of the rounded image, [K]."""
    variation: Variation | None = None
    samples: tuple[Evaluation, ...] = ()
    """Evaluations of the same perturbation under the variations of the step."""
    objective: float = nan
    """Loss that is differentiated (`AttackProblem.objective`), without λ: the mean over the scene and `samples`."""
    gradient: Tensor | None = None
    """∂(objective + λ·‖ΔY‖²)/∂delta [total], likewise; None for attacks that need none."""
    metric: Tensor | None = None
    """M [total, total], where differences of images keep it: dᵀMd is p² of a small change d."""

    @property
    def answers(self) -> Tensor:
        """The scores of the scene itself and under its variations, without a graph: [1 + samples, K]."""
        return torch.stack([self.scores, *(sample.scores for sample in self.samples)]).detach()

    def detached(self) -> Evaluation:
        """The same without graphs."""
        names = ("delta", "rendered", "image", "scores")
        return replace(self, **{name: getattr(self, name).detach() for name in names})


@dataclass(frozen=True)
class AttackProblem:
    """Parameters that may change, the loss to minimise, and the renderer and network that evaluate it. Only `counts`
    changes while an attack runs.

    A perturbation is one vector `delta` [total]: the changes of all attacked groups, in the order of `layout` and each
    in its group's unit. Images are [B, H, W, 3] in [0,1]; scores are [B, K], before the softmax. `AttackProblem.of`
    makes one.
    """

    renderer: Renderer
    target: Target
    goal: ResolvedGoal
    limits: Limits
    initial: Tensor
    """The scene's own values [total]."""
    original: Tensor
    """Their image [1, H, W, 3], from which U and the distance are measured."""
    start: Tensor
    """The first perturbation [total]: zero, or random after a restart."""
    seed: int = 0
    first_step: int = 0
    """The attack's step at which this start begins; variations are drawn anew for each step of the attack."""
    loss: Loss = "log-odds"
    """Loss that gradients are of; its value is the objective of an evaluation."""
    distance_weight: float = 0.0
    """λ of the squared distance ‖ΔY‖² from the original."""
    expectation: Expectation | None = None
    """Views, light and cameras over which the objective is averaged; None: the scene itself alone."""
    surrogate: Surrogate | None = None
    differences: Differences | None = None
    """Takes gradients of images for a renderer that has none; None: the renderer's own are taken."""
    counts: Counts = field(default_factory=Counts)
    interrupt: Callable[[], None] = lambda: None
    """Called before every rendering; raises Cancelled to stop."""

    @classmethod
    def of(cls, renderer: Renderer, target: Target, goal: ResolvedGoal, limits: Limits, **others: Any) -> AttackProblem:
        """The problem of attacking the groups of `limits`; `others` are fields. Renders the original, which counts."""
        initial = limits.layout.flatten(renderer.initial())
        nothing = torch.zeros_like(initial)
        problem = cls(renderer, target, goal, limits, initial, torch.zeros(0), nothing, **others)
        with torch.no_grad():
            return replace(problem, original=problem.render(nothing[None]))

    @property
    def layout(self) -> Layout:
        """The position of each attacked group in a perturbation."""
        return self.limits.layout

    @property
    def nothing(self) -> Tensor:
        """The perturbation [total] of zeros."""
        return torch.zeros_like(self.initial)

    @property
    def per_batch(self) -> int:
        """The number of images rendered in one batch: at most `MAX_BATCH`, of at most `CHUNK_VALUES` values."""
        height, width = self.renderer.size
        return max(1, min(MAX_BATCH, CHUNK_VALUES // (height * width * 3)))

    def generator(self, *words: str | int) -> torch.Generator:
        """Random numbers that depend on the seed and on `words` alone, which name the purpose and the step."""
        return generator(self.seed, *words)

    def variations(self, step: int) -> tuple[Variation, ...]:
        """The variations of a step of this start, over which the objective is averaged beside the scene itself."""
        if self.expectation is None:
            return ()
        number = self.first_step + step
        return tuple(
            draw_variation(self.expectation, self.seed, "step", number, n) for n in range(self.expectation.samples)
        )

    def render(self, deltas: Tensor, variation: Variation | None = None) -> Tensor:
        """Images [B, H, W, 3] of perturbations [B, total], under a variation. Raises JobFailure for what is no image,
        and Cancelled.
        """
        self.interrupt()
        parameters = self.layout.unflatten(self.initial + deltas)
        with named(f"renderer {self.renderer.name!r}"):
            images = self.renderer.render(
                parameters if variation is None else varied(self.renderer, parameters, variation)
            )
        self.counts.renders += len(deltas)
        check_images(self.renderer, images, len(deltas))
        return images if variation is None else taken(images, variation)

    def scores(self, images: Tensor) -> Tensor:
        """The network's scores [B, K] of images. Raises JobFailure for what are no scores."""
        self.counts.queries += len(images)
        with named(f"target {self.target.name!r}"):
            scores = self.target.logits(images)
        check_scores(self.target, scores, len(images))
        return scores

    def objective(self, scores: Tensor) -> Tensor:
        """The loss of scores [..., K] that gradient methods minimise, [...]."""
        return loss(self.loss, self.goal, scores)

    def feasible(self, deltas: Tensor) -> Tensor:
        """Perturbations [B, total], projected to the constraint, and pulled back where the limits ask for it, until no
        value of their images is beyond U and their p is within its limit.
        """
        deltas = self.limits.project(deltas)
        return pulled_back(self._reach, deltas.detach()) if self.limits.backtracks else deltas

    @torch.no_grad()
    def _reach(self, delta: Tensor) -> float:
        if not self.limits.holds(delta):
            return 2.0  # anything above 1 is beyond the limit
        return self.limits.reached(self.render(delta[None]), self.original)  # the limits are those of the scene itself

    @torch.no_grad()
    def objectives(self, deltas: Tensor, step: int = 0) -> Tensor:
        """The objective of methods that search by scores, at perturbations [B, total]: float64 [B] on the CPU.

        It is the log-probability advantage of the present answer + λ·‖ΔY‖². With an expectation the advantage is the
        mean over the scene itself and the variations of `step`; λ weighs the change of the scene itself. Images are
        not rounded. Raises as `render` and `scores` do.
        """
        objectives = []
        for chunk in torch.split(deltas, self.per_batch):
            images = self.render(chunk)
            if self.limits.truncation is not None:
                images = torch.cat([self.limits.truncate(image[None], self.original)[0] for image in images])
            advantages = [self.advantages(images)]
            advantages += [self.advantages(self.render(chunk, variation)) for variation in self.variations(step)]
            objectives.append((torch.stack(advantages).mean(dim=0) + self.penalty(images)).cpu())
        return torch.cat(objectives)

    def advantages(self, images: Tensor) -> Tensor:
        """The log-probability advantage of the present answer, of images: float64 [B]."""
        return self.goal.advantage(self.scores(images)).double()

    def penalty(self, images: Tensor) -> Tensor | float:
        """λ‖ΔY‖² of images, float64 [B]; 0 without λ. The sums run over each image, never over the batch."""
        weight = self.distance_weight
        return 0.0 if weight == 0 else weight * distances(images, self.original).square()


def at_random_start(problem: AttackProblem, number: int, first_step: int) -> AttackProblem:
    """The problem of restart `number`, from 1: it begins at a random point of the box, and has a seed of its own."""
    start = random_start(problem.limits, problem.seed, number)
    return replace(problem, start=start, seed=derived(problem.seed, "restart", number), first_step=first_step)


def random_start(limits: Limits, seed: int, restart: int) -> Tensor:
    """A uniformly random perturbation [total] within a box that is finite."""
    layout = limits.layout
    shares = [
        torch.rand(layout.shapes[g].numel(), generator=generator(seed, "start", g, restart), dtype=torch.float64)
        for g in layout.groups
    ]
    return (limits.low + (limits.high - limits.low) * torch.cat(shares)).to(limits.low.dtype)


def evaluate(problem: AttackProblem, delta: Tensor, step: int, gradient: bool = False) -> Evaluation:
    """Looks at a perturbation [total], and at it under each variation of the step.

    With `gradient` the evaluation has a graph, of which `differentiate` makes the gradient; those of its samples are
    made at once, to free their memory. Takes a query for each image. Raises JobFailure for a perturbation of another
    shape, or with values that are not finite or beyond the box, and as `AttackProblem.render` and `scores` do.
    """
    evaluation = _look(problem, delta, step, gradient, None)
    samples = []
    for variation in problem.variations(step):
        sample = _look(problem, evaluation.delta, step, gradient, variation)
        samples.append(_differentiated(problem, sample) if gradient else sample)
    return replace(evaluation, samples=tuple(samples))


def _look(problem: AttackProblem, delta: Tensor, step: int, gradient: bool, variation: Variation | None) -> Evaluation:
    check_perturbation(problem, delta)
    limits, renders_gradients = problem.limits, gradient and problem.differences is None
    if limits.backtracks or limits.constraint is not None:
        delta = problem.feasible(delta.detach()[None])[0]
    delta = delta.detach().clone().requires_grad_(renders_gradients)
    with torch.set_grad_enabled(renders_gradients):
        rendered = problem.render(delta[None], variation)
    with torch.set_grad_enabled(gradient):
        if gradient and not renders_gradients:
            rendered = rendered.detach().requires_grad_()
        image, truncated = limits.truncate(rendered, problem.original)
        saved, rounded = quantize(image)
        [scores] = problem.scores(rounded)
    return Evaluation(step, delta, rendered, image, truncated, saved[0], scores, variation)


def differentiate(problem: AttackProblem, evaluation: Evaluation) -> Evaluation:
    """The evaluation with the objective's gradient, the mean over the scene itself and its variations, and no graph.

    Raises JobFailure("non-finite") naming the group, and JobFailure("internal") if there is no graph.
    """
    own = _differentiated(problem, evaluation)
    gradients = [sample.gradient for sample in evaluation.samples if sample.gradient is not None]
    assert own.gradient is not None
    return replace(own, gradient=sum(gradients, own.gradient) / (1 + len(gradients)))


def _differentiated(problem: AttackProblem, evaluation: Evaluation) -> Evaluation:
    check_graph(problem.renderer, problem.target, evaluation.image, evaluation.scores)
    objective = problem.objective(evaluation.scores)
    if problem.distance_weight:
        distance = (evaluation.image - problem.original).square().sum().to(objective.device)
        objective = objective + problem.distance_weight * distance
    leaf = evaluation.delta if problem.differences is None else evaluation.rendered
    # zeros where every pixel is truncated, or does not depend on the parameter
    (gradient,) = torch.autograd.grad(objective, [leaf], materialize_grads=True)
    evaluation, metric = evaluation.detached(), None
    if problem.differences is not None:
        gradient, metric = problem.differences.project(
            problem, evaluation.delta, gradient[0], evaluation.step, evaluation.variation
        )
    for group, values in problem.layout.unflatten(gradient).items():
        if not finite(values):
            raise JobFailure("non-finite", f"the gradient of group {group!r} has values that are not finite")
    return replace(evaluation, gradient=gradient, metric=metric)


def distances(images: Tensor, original: Tensor) -> Tensor:
    """Euclidean distance ‖ΔY‖ of each image [B, H, W, 3] from the original [1, H, W, 3]: [B] float64.

    Differences and their sums along a row are of the images' dtype, which costs a few last places; the long sum over
    rows is in float64.
    """
    rows = torch.linalg.vector_norm((images - original).flatten(2), dim=2)
    lengths: Tensor = torch.linalg.vector_norm(rows, dim=1, dtype=torch.float64)
    return lengths


def draw_variation(asked: Expectation, seed: int, *words: str | int) -> Variation:
    """A variation from the range, which depends on the seed and on `words` alone."""
    random = generator(seed, "variation", *words)
    around = (2 * torch.rand(5, generator=random, dtype=torch.float64) - 1).tolist()
    return Variation(
        azimuth=radians(asked.azimuth) * around[0],
        elevation=radians(asked.elevation) * around[1],
        roll=radians(asked.roll) * around[2],
        distance=1 + asked.distance * around[3],
        intensity=1 + asked.intensity * around[4],
        sensor=PLAIN if asked.sensor is None else draw_sensor(asked.sensor, seed, *words),
        seed=derived(seed, "camera noise", *words),
    )


def draw_sensor(asked: SensorRange, seed: int, *words: str | int) -> Sensor:
    """A camera from the range, which depends on the seed and on `words` alone."""
    random = generator(seed, "sensor", *words)
    return asked.at(torch.rand(DRAWS, generator=random, dtype=torch.float64).tolist())


# Random numbers of an attack that may be resumed: each step has a generator of its own, derived from the job's seed


def generator(seed: int, *words: str | int) -> torch.Generator:
    """A CPU generator that depends on the seed and on `words` alone, which name the purpose and the step."""
    return torch.Generator().manual_seed(derived(seed, *words))


def derived(seed: int, *words: str | int) -> int:
    """A seed of 63 bits that depends on the seed and on `words` alone."""
    text = "/".join([str(seed), *map(str, words)])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") % 2**63


def draw(pool: Tensor, count: int, seed: int, *words: str | int) -> Tensor:
    """Draws `count` distinct elements of `pool` [n], in ascending order; all of them if n is smaller."""
    chosen = torch.randperm(len(pool), generator=generator(seed, *words))[:count]
    return pool[chosen].sort().values


def quantize(images: Tensor) -> tuple[Tensor, Tensor]:
    """Rounds images in [0,1], of any shape, to 8 bits. Returns them as uint8 and as k/255 in float32.

    The derivative of the float32 result is that of the unrounded images (a straight-through derivative), so one pass of
    the network gives both the verdict on the saved image and the gradient.
    """
    result: tuple[Tensor, Tensor] = _Quantize.apply(images)  # type: ignore[no-untyped-call]
    return result


class _Quantize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, images: Tensor) -> tuple[Tensor, Tensor]:
        saved, seen = color.quantize(images)
        ctx.mark_non_differentiable(saved)
        return saved, seen

    @staticmethod
    def backward(ctx: Any, none: None, gradient: Tensor) -> Tensor:  # noqa: ARG004 - autograd's signature
        return gradient


def check_images(renderer: Renderer, images: Tensor, count: int) -> None:
    """Raises JobFailure unless `images` are `count` images of the renderer's size, with values in [0,1]."""
    shape = (count, *renderer.size, 3)
    if not isinstance(images, Tensor) or images.shape != shape or not images.is_floating_point():
        raise _internal("renderer", renderer.name, "images", shape, images)
    low, high = (float(value) for value in torch.aminmax(images.detach()))
    if not torch.tensor([low, high]).isfinite().all():
        raise JobFailure("non-finite", "the renderer returned an image with values that are not finite")
    if low < -SLACK or high > 1 + SLACK:
        detail = f"an image with values from {low:g} to {high:g}, not in [0,1]"
        raise JobFailure("internal", f"renderer {renderer.name!r} returned {detail}")


def check_scores(target: Target, scores: Tensor, count: int) -> None:
    """Raises JobFailure unless `scores` are finite, one row an image and one score a label."""
    shape = (count, len(target.labels))
    if not isinstance(scores, Tensor) or scores.shape != shape or not scores.is_floating_point():
        raise _internal("target", target.name, "scores", shape, scores)
    if not finite(scores):
        raise JobFailure("non-finite", "the network returned scores that are not finite")


def check_graph(renderer: Renderer, target: Target, images: Tensor, scores: Tensor) -> None:
    """Raises JobFailure unless the scores of `images` can be differentiated, where a gradient is needed."""
    if not scores.requires_grad:
        whose = (
            f"target {target.name!r} returned scores"
            if images.requires_grad
            else f"renderer {renderer.name!r} returned images"
        )
        raise JobFailure(
            "internal", f"{whose} without a graph; a gradient is needed, and it is said to be differentiable"
        )


def check_perturbation(problem: AttackProblem, delta: Tensor) -> None:
    """Raises JobFailure unless an attack's perturbation is a floating-point vector [total] with values that are finite
    and within the box.
    """
    layout, limits = problem.layout, problem.limits
    if not isinstance(delta, Tensor) or delta.shape != (layout.total,) or not delta.is_floating_point():
        description = f"{delta.dtype} of {list(delta.shape)}" if isinstance(delta, Tensor) else type(delta).__name__
        raise JobFailure(
            "internal", f"the attack's perturbation is {description}; floating-point [{layout.total}] is due"
        )
    for group, values in layout.unflatten(delta.detach()).items():
        if not finite(values):
            raise JobFailure("non-finite", f"the perturbation of group {group!r} has values that are not finite")
    beyond = torch.maximum(limits.low - delta, delta - limits.high).detach()
    if bool((beyond > BOUND_SLACK * (1 + problem.initial.abs())).any()):
        group = layout.group_of(int(beyond.argmax()))
        raise JobFailure(
            "internal",
            f"the attack left the bounds of group {group!r} by up to {float(beyond.max()):g}; "
            "`problem.limits.clamp` keeps a perturbation within them",
        )


def _internal(kind: str, name: str, what: str, shape: tuple[int, ...], value: object) -> JobFailure:
    description = f"{value.dtype} of {list(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
    return JobFailure(
        "internal", f"{kind} {name!r} returned {what} as {description}; floating-point {list(shape)} is due"
    )
