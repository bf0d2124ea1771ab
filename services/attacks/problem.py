"""An attack's problem: a renderer, a network and a goal, with counts of the images rendered and classified.

Images are rounded to 8 bits with a straight-through derivative, so that an attack sees the image that is saved. What
renderers, networks and methods return is checked here: an extension that breaks its protocol must end its job with a
reason. Unchecked, most of what it may return is a result: values beyond [0,1] are clipped when the image is saved, and
scores that are no numbers have a largest one too.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import nan, radians
from typing import Any, Protocol

import torch
from torch import Tensor

from services.attacks.expectation import Expectation
from services.attacks.goal import ResolvedGoal
from services.attacks.limits import (
    ROUNDING,
    Constraint,
    Layout,
    held,
    perturbation_bounds,
    projected,
    pulled_back,
    random_start,
    reached,
)
from services.attacks.losses import Loss, loss
from services.attacks.seeds import derived, generator
from services.attacks.surrogate import Surrogate
from services.device import finite
from services.errors import JobFailure, named, summary
from services.rendering import color
from services.rendering.protocol import BOUND_SLACK, Parameters, Renderer
from services.rendering.variation import Variation, noisy, varied
from services.targets.protocol import Target


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
        noise=asked.noise / 255,
        seed=derived(seed, "camera noise", *words),
    )


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


SLACK = 1e-4
"""How far rounding may take a displayed value out of [0,1]; a fortieth of a step of an 8-bit image."""


def check_images(renderer: Renderer, images: Tensor, count: int) -> None:
    """Raises JobFailure unless `images` are `count` images of the renderer's size, with values in [0,1]."""
    shape = (count, *renderer.size, 3)
    if not isinstance(images, Tensor) or images.shape != shape or not images.is_floating_point():
        raise _internal("renderer", renderer.name, "images", shape, images)
    low, high = (float(value) for value in torch.aminmax(images.detach()))
    if not torch.tensor([low, high]).isfinite().all():
        raise JobFailure("non-finite", "the renderer returned an image with values that are not finite")
    if low < -SLACK or high > 1 + SLACK:
        found = f"an image with values from {low:g} to {high:g}, not in [0,1]"
        raise JobFailure("internal", f"renderer {renderer.name!r} returned {found}")


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


def check_perturbation(
    given: Mapping[str, Tensor], initial: Mapping[str, Tensor], bounds: Mapping[str, tuple[Tensor, Tensor]]
) -> None:
    """Raises JobFailure unless a method's perturbation has the attacked groups in their shapes, and values that are
    finite and within `bounds`, the smallest and largest perturbation of each group that has any.
    """
    if not isinstance(given, Mapping) or not all(isinstance(value, Tensor) for value in given.values()):
        raise JobFailure("internal", "the method's perturbation is no tensor for each group")
    shapes = {group: tuple(value.shape) for group, value in given.items()}
    expected = {group: tuple(value.shape) for group, value in initial.items()}
    if shapes != expected:
        raise JobFailure("internal", f"the method's perturbation has the groups {shapes}; attacked are {expected}")
    for group, value in given.items():
        if not value.is_floating_point():
            raise JobFailure("internal", f"the perturbation of group {group!r} is of {value.dtype}, not floating-point")
        if not finite(value):
            raise JobFailure("non-finite", f"the perturbation of group {group!r} has values that are not finite")
        low, high = bounds.get(group, (value, value))
        beyond = torch.maximum(low - value, value - high).detach()
        if bool((beyond > BOUND_SLACK * (1 + initial[group].abs())).any()):
            raise JobFailure(
                "internal",
                f"the method left the bounds of group {group!r} by up to {float(beyond.max()):g}; "
                "AttackProblem.clamp keeps a perturbation within them",
            )


def check_settings(found: object) -> None:
    """Raises JobFailure unless `Method.start` returned a dict that can be stored as JSON."""
    try:
        if isinstance(found, dict):
            json.dumps(found, allow_nan=False)
            return
    except (TypeError, ValueError) as error:
        raise JobFailure("internal", f"the settings that the method measured are not JSON: {summary(error)}") from error
    raise JobFailure("internal", f"the method's start returned a {type(found).__name__}; a dict of settings is due")


def check_state(state: object) -> None:
    """Raises JobFailure unless `Method.state` returned tensors by name, which a checkpoint can save."""
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise JobFailure("internal", "the method's state is no dict of tensors; a checkpoint could not save it")


def check_count(count: object) -> None:
    """Raises JobFailure unless `Method.advance` returned a count."""
    if not isinstance(count, int) or count < 0:
        raise JobFailure("internal", f"the method's advance returned {count!r:.80}; a count from 0 is due")


def _internal(kind: str, name: str, what: str, shape: tuple[int, ...], given: object) -> JobFailure:
    found = f"{given.dtype} of {list(given.shape)}" if isinstance(given, Tensor) else type(given).__name__
    return JobFailure("internal", f"{kind} {name!r} returned {what} as {found}; floating-point {list(shape)} is due")


@dataclass(frozen=True)
class Evaluation:
    """One perturbation, its image, and its gradients."""

    perturbation: Parameters
    """The perturbation by group; its tensors are leaves of the graph of `images` if a gradient was asked for."""
    images: Tensor
    """The float image [1, H, W, 3] in [0,1], truncated to U around the original."""
    truncated: Tensor
    """Pixels with a truncated value, bool [H, W]."""
    gradients: Parameters = field(default_factory=dict)
    """∂objective/∂perturbation by group, for a method that needs it; see `gradients`."""
    objective: float = nan
    """The objective of the image rounded to 8 bits, without an own query of the network; see `AttackProblem.loss`."""

    @property
    def n_flat(self) -> int:
        """The number of groups whose gradient is zero throughout."""
        return sum(bool(gradient.min() == gradient.max() == 0) for gradient in self.gradients.values())


class Differences(Protocol):
    """Derivatives of images for a renderer that has none (`image_differences`)."""

    metric: Tensor | None
    """The metric of the newest gradient; see `AttackProblem.needs_metric`."""

    def render(self, problem: "AttackProblem", perturbation: Parameters) -> Tensor:
        """The image [1, H, W, 3] of a perturbation, with a graph to the perturbation's tensors."""
        ...


@dataclass
class AttackProblem:
    """Renders perturbations and classifies images, and counts both (`renders`, `queries`).

    `truncation` is U in [0,1] or None; `weight` is λ of the summed squares of the image's change (zoo). `backtrack` is
    U of the constraint `backtrack`, or None. `epsilon` and `limits` are the request's ε and bounds of the values, by
    group.
    """

    renderer: Renderer
    target: Target
    goal: ResolvedGoal
    groups: tuple[str, ...]
    seed: int = 0
    truncation: float | None = None
    weight: float = 0.0
    loss: Loss = "log-odds"
    """What the gradients are of, and the objective of an evaluation."""
    backtrack: float | None = None
    perceptibility: float | None = None
    """Largest p of an image, to which the constraint `backtrack` pulls perturbations back; None if there is none."""
    epsilon: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    interrupt: Callable[[], None] = lambda: None
    """Called before every rendering; raises Cancelled to stop."""
    differences: Differences | None = None
    """Differences of the image, by which `view` differentiates it if the renderer cannot; None if it can."""
    needs_metric: bool = False
    """Whether `differences` keeps the metric M [total, total] of each gradient: dᵀMd is p² of a small change d."""
    surrogate: Surrogate | None = None
    """The network whose gradients guide a method that searches by scores; None if there is none."""
    expectation: Expectation | None = None
    """The range of views, light and noise over which the objective is averaged; None: the scene itself alone."""
    constraint: Constraint | None = None
    """What the scene allows beyond bounds; every perturbation that is viewed is projected to it."""
    queries: int = 0
    renders: int = 0
    surrogate_queries: int = 0
    """Images that the surrogate classified."""
    initial: Parameters = field(init=False)
    original: Tensor = field(init=False)
    layout: Layout = field(init=False)
    """The attacked groups as one vector."""
    bounds: dict[str, tuple[Tensor, Tensor]] = field(init=False)
    """Smallest and largest perturbation of each group that has any limit (`feasible`)."""
    beginning: Parameters = field(init=False)
    """The perturbation with which a method begins: zeros, or a random one for a restart."""
    variations: tuple[Variation, ...] = field(init=False, default=())
    """The variations of this step, over which the objective is averaged beside the scene itself."""
    variation: Variation | None = field(init=False, default=None)
    """The one under which `render` draws at present; None: the scene itself."""

    def __post_init__(self) -> None:
        start = self.renderer.initial()
        self.initial = {group: start[group] for group in self.groups}
        self.layout = Layout.of(self.initial)
        bounds = perturbation_bounds(self.initial, self.renderer.bounds(), self.limits, self.epsilon)
        self.bounds = held(bounds, self.constraint)
        self.beginning = self.nothing()
        with torch.no_grad():
            self.original = self.render({g: v[None] for g, v in self.initial.items()})

    def nothing(self) -> Parameters:
        """The perturbation of zeros."""
        return {group: torch.zeros_like(value) for group, value in self.initial.items()}

    def restart(self, number: int) -> None:
        """Moves the beginning to a random point within the bounds, and the seed to one of its own, for restart
        `number`, from 1.
        """
        self.beginning = random_start(self.initial, self.bounds, self.seed, number)
        self.seed = derived(self.seed, "restart", number)

    def draw(self, step: int) -> None:
        """Draws the variations of a step."""
        if self.expectation is not None:
            numbers = range(self.expectation.samples)
            self.variations = tuple(draw_variation(self.expectation, self.seed, "step", step, n) for n in numbers)

    @contextmanager
    def under(self, variation: Variation | None) -> Iterator[None]:
        """Draws under a variation as long as the context lasts."""
        before, self.variation = self.variation, variation
        try:
            yield
        finally:
            self.variation = before

    def clamp(self, perturbation: Mapping[str, Tensor]) -> Parameters:
        """The perturbation, clamped to `bounds`."""
        return {
            group: value.clamp(*self.bounds[group]) if group in self.bounds else value
            for group, value in perturbation.items()
        }

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Images [B, H, W, 3] of groups with B values each, under the present variation. Raises JobFailure for what is
        no image (`contract`).
        """
        self.interrupt()
        count = len(next(iter(parameters.values())))
        variation = self.variation
        with named(f"renderer {self.renderer.name!r}"):
            images = self.renderer.render(
                parameters if variation is None else varied(self.renderer, parameters, variation)
            )
        self.renders += count
        check_images(self.renderer, images, count)
        return images if variation is None else noisy(images, variation)

    def view(self, perturbation: Mapping[str, Tensor], gradient: bool = False) -> Evaluation:
        """The image of one perturbation, truncated to U around the original; with a graph if `gradient`.

        With `backtrack`, of the perturbation pulled back until its image is within U, which the view then names. The
        graph is the renderer's own, or that of `differences` if the renderer has none.

        Raises JobFailure for a perturbation of other groups or shapes, or with values that are not finite or beyond the
        renderer's bounds.
        """
        check_perturbation(perturbation, self.initial, self.bounds)
        if self._backtracks or self.constraint is not None:
            perturbation = self.layout.unflatten(self.feasible(self.layout.flatten(perturbation)[None])[0])
        leaves = {g: value.detach().requires_grad_(gradient) for g, value in perturbation.items()}
        with torch.set_grad_enabled(gradient):
            if gradient and self.differences is not None:
                images = self.differences.render(self, leaves)
            else:
                images = self.render({g: (self.initial[g] + value)[None] for g, value in leaves.items()})
            return Evaluation(leaves, *truncate(images, self.original, self.truncation))

    def feasible(self, vectors: Tensor) -> Tensor:
        """The perturbations [B, total], projected to the constraint, and pulled back with `backtrack` until no value of
        their images is beyond U, and until the images' p is within `perceptibility`.
        """
        vectors = projected(self.constraint, self.layout, vectors)
        return pulled_back(self._reach, vectors.detach()) if self._backtracks else vectors

    @property
    def _backtracks(self) -> bool:
        return self.backtrack is not None or self.perceptibility is not None

    @torch.no_grad()
    def _reach(self, vector: Tensor) -> float:
        if self.constraint is not None and not self.constraint.holds(self.layout.unflatten(vector)):
            return 2.0  # anything above 1 is beyond the limit
        with self.under(None):  # the limits are those of the scene itself
            image = self.render(self.layout.unflatten((self.layout.flatten(self.initial) + vector)[None]))
            return reached(image, self.original, self.backtrack, self.perceptibility)

    def objective(self, logits: Tensor) -> Tensor:
        """The loss of logits [..., K] that is minimised, [...]."""
        return loss(self.loss, self.goal, logits)

    def logits(self, images: Tensor) -> Tensor:
        """Scores [B, K] of images [B, H, W, 3]. Raises JobFailure for what are no scores (`contract`)."""
        self.queries += len(images)
        with named(f"target {self.target.name!r}"):
            logits = self.target.logits(images)
        check_scores(self.target, logits, len(images))
        return logits


def gradients(problem: AttackProblem, view: Evaluation, logits: Tensor) -> Parameters:
    """∂objective/∂perturbation at a view, by group.

    The objective is the goal's, plus λ·‖ΔY‖² if the problem has a `weight`. `logits` [1, K] has a graph that leads to
    the view. Raises JobFailure("non-finite") naming the group, and JobFailure("internal") if there is no graph.
    """
    check_graph(problem.renderer, problem.target, view.images, logits)
    objective = problem.objective(logits[0])
    if problem.weight:
        objective = objective + problem.weight * (view.images - problem.original).square().sum().to(objective.device)
    leaves = [view.perturbation[group] for group in problem.groups]
    # zeros where every pixel is truncated, or does not depend on the parameter
    by_leaf = torch.autograd.grad(objective, leaves, materialize_grads=True)
    found = dict(zip(problem.groups, by_leaf, strict=True))
    for group, gradient in found.items():
        if not finite(gradient):
            raise JobFailure("non-finite", f"the gradient of group {group!r} has values that are not finite")
    return found


def distances(images: Tensor, original: Tensor) -> Tensor:
    """Euclidean distance ‖ΔY‖ of each image [B, H, W, 3] from the original [1, H, W, 3]: [B] float64.

    Differences and their sums along a row are of the images' dtype, which costs a few last places; the long sum over
    rows is in float64.
    """
    rows = torch.linalg.vector_norm((images - original).flatten(2), dim=2)
    found: Tensor = torch.linalg.vector_norm(rows, dim=1, dtype=torch.float64)
    return found


def truncate(images: Tensor, original: Tensor, limit: float | None) -> tuple[Tensor, Tensor]:
    """Clamps RGB values to within `limit` of the original. Returns the images and the mask of changed pixels.

    `images` and `original` are [1, H, W, 3] in [0,1]; `limit` is in [0,1], or None for no limit; the mask is bool
    [H, W]. A clamped value passes no gradient (paper, section 3.3).
    """
    nowhere = torch.zeros(images.shape[1:3], dtype=torch.bool, device=images.device)
    if limit is None:
        return images, nowhere
    change = images.detach() - original
    low, high = torch.aminmax(change)
    if max(-float(low), float(high)) <= limit + ROUNDING:
        return images, nowhere
    held = (change.abs_().amax(dim=-1) > limit + ROUNDING)[0]
    return images.clamp(original - limit, original + limit), held
