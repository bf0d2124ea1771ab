"""The loop that runs every attack: evaluate, verify, stop or advance."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import sqrt
from pathlib import Path
from time import monotonic
from typing import Any

import torch
from torch import Tensor

from services.attacks import checkpoint
from services.attacks.contract import check_count, check_settings, check_state
from services.attacks.image_differences import ImageDifferences
from services.attacks.method import Method
from services.attacks.problem import AttackProblem, Evaluation, distances, gradients
from services.attacks.quantize import quantize
from services.attacks.samples import Sampled, mean_gradients, sample
from services.attacks.state import AttackState
from services.attacks.trace import TraceRow
from services.attacks.verifier import Verifier
from services.errors import named
from services.rendering.image_error import ImageError
from services.rendering.protocol import Parameters
from services.targets.scores import probability

DIFFERENCES = "image_differences"
"""Name among a result's settings of those of `ImageDifferences`."""


@dataclass(frozen=True)
class Budget:
    """The limits at which an attack stops without success; None means no limit.

    `queries` counts every image that the network classifies, verification included. `seconds` is wall-clock time over
    all attempts of a job. `steps` is the limit of each start.
    """

    steps: int
    queries: int | None = None
    seconds: float | None = None


def run(
    problem: AttackProblem,
    method: Method,
    verifier: Verifier,
    budget: Budget,
    *,
    checkpoint_path: Path | None = None,
    on_row: Callable[[TraceRow], None] = lambda _: None,
    restarts: int = 0,
    fresh: Callable[[], Method] | None = None,
) -> AttackState:
    """Attacks until an adversary is verified or the budget is spent, and returns the final state.

    At every step the network classifies the image rounded to 8 bits. If the goal is met, the verifier renders the
    perturbation by the exact path and asks the network again. The loop ends if that image meets the goal too, and goes
    on otherwise (truncation makes image and parameters disagree).

    The attack resumes from the file `checkpoint_path` if it holds a readable checkpoint, and writes it every few
    seconds. It calls `on_row` with every new row of the trace. A start that took all its steps is followed by up to
    `restarts` others, whose methods `fresh` makes.

    Raises JobFailure("non-finite") if an image, a score or a gradient is not finite, JobFailure("internal") if
    renderer, target or method break their protocol (`contract`), and what `problem.interrupt` raises.
    """
    attack = _Running(problem, method, verifier, budget, checkpoint_path, on_row, restarts, fresh)
    state = attack.begin_or_resume()
    while not state.stopped:
        view, image, logits = attack.evaluate()
        sampled = sample(problem, view, attack.method.needs_gradient)
        attack.record(view, image, logits[0].detach(), sampled)
        if not state.stopped:
            attack.advance(attack.differentiate(view, logits, sampled))
        attack.restart_if_spent()
        attack.save_if_due()
    return state


@dataclass
class _Running:
    """An attack under way: the arguments of `run`, and how far it has come."""

    problem: AttackProblem
    method: Method
    verifier: Verifier
    budget: Budget
    checkpoint_path: Path | None
    on_row: Callable[[TraceRow], None]
    restarts: int
    fresh: Callable[[], Method] | None
    state: AttackState = field(init=False)
    began: float = field(init=False)
    """When it would have begun without interruptions, in seconds of the monotonic clock; `last_saved` likewise."""
    last_saved: float = field(init=False)

    @property
    def name(self) -> str:
        return f"method {type(self.method).__name__!r}"

    @property
    def seconds(self) -> float:
        return monotonic() - self.began

    def begin_or_resume(self) -> AttackState:
        """The state, from the checkpoint if there is one; else the method is started."""
        with named(self.name):
            saved = checkpoint.load(self.checkpoint_path, self.problem, self.method, self.verifier)
        self.state = saved or AttackState(ever=torch.zeros(self.problem.renderer.size, dtype=torch.bool))
        for number in range(1, self.state.restart + 1):
            self.problem.restart(number)
        self.began, self.last_saved = monotonic() - self.state.seconds, monotonic()
        resumed = bool(self.state.settings or self.state.trace)
        measured = self._differences(resumed)
        if not resumed:
            self.state.settings = self.start() | measured
        return self.state

    def _differences(self, resumed: bool) -> dict[str, object]:
        """Prepares differences of images if the method needs gradients through a renderer that has none. Returns their
        settings as `image_differences`, from which a resumed attack takes them.
        """
        problem = self.problem
        if problem.renderer.differentiable or not self.method.needs_gradient:
            return {}
        if resumed:
            settings: Any = self.state.settings[DIFFERENCES]
            differences = ImageDifferences.load(problem, settings)
        else:
            differences = ImageDifferences.measure(problem)
        problem.differences = differences
        return {DIFFERENCES: differences.settings(problem)}

    def start(self) -> dict[str, object]:
        """Starts the method. Returns the settings that it measured."""
        self.problem.draw(self.state.step)
        with named(self.name):
            settings = self.method.start(self.problem)
            check_state(self.method.state())
        check_settings(settings)
        return settings

    def evaluate(self) -> tuple[Evaluation, Tensor, Tensor]:
        """The view of the present perturbation, its image as saved (uint8 [H, W, 3]) and that image's scores [1, K],
        with a graph if the method needs gradients.
        """
        problem, gradient = self.problem, self.method.needs_gradient
        problem.draw(self.state.step)
        with named(self.name):
            perturbation = self.method.perturbation
        view = problem.view(perturbation, gradient=gradient)
        with torch.set_grad_enabled(gradient):
            images, rounded = quantize(view.images)
            return view, images[0], problem.logits(rounded)

    def record(self, view: Evaluation, image: Tensor, logits: Tensor, sampled: Sampled) -> None:
        """Records an evaluation, its image as saved (uint8 [H, W, 3]) and the scores [K]; verifies; may stop.

        With an expectation an attack is verified only once the answers to all variations of a step meet the goal too.
        """
        state, problem, verifier = self.state, self.problem, self.verifier
        row = self._row(view, logits, sampled)
        fooled = bool(problem.goal.fooled(logits))
        state.ever |= view.truncated.cpu()
        best = not state.trace or _rank(row) >= _rank(state.trace[state.stored_step])
        if best if problem.variations else fooled or (best and not state.fooled):
            state.stored = {group: view.perturbation[group].detach().clone() for group in problem.groups}
            state.stored_step = state.step
            state.image, state.scores = image.cpu().clone(), logits.cpu().clone()
        state.fooled |= fooled
        if fooled and row.share in (None, 1.0):
            state.verified = verifier.fooled(state.stored, problem.goal)
        state.trace.append(row)
        self.on_row(row)
        state.stopped = self._stop_reason()

    def _row(self, view: Evaluation, logits: Tensor, sampled: Sampled) -> TraceRow:
        state, problem, verifier = self.state, self.problem, self.verifier
        minimised = problem.objective if self.method.needs_gradient else problem.goal.advantage
        height, width = problem.renderer.size
        distance = float(distances(view.images.detach(), problem.original)[0])
        label = int(logits.argmax())
        return TraceRow(
            step=state.step,
            restart=state.restart,
            loss=float(problem.goal.loss(logits)),
            label=problem.target.labels[label],
            confidence=float(probability(logits, label)),
            advantage=float(problem.goal.advantage(logits)),
            objective=float(minimised(sampled.answers(logits)).mean()) + problem.weight * distance**2,
            share=float(problem.goal.fooled(sampled.logits).double().mean()) if problem.variations else None,
            distance=distance,
            perceptibility=distance / sqrt(height * width),
            truncated=int(view.truncated.sum()),
            below_noise=state.below_noise,
            queries=problem.queries + verifier.queries,
            surrogate_queries=problem.surrogate_queries,
            renders=problem.renders + verifier.renders,
            seconds=self.seconds,
        )

    def _stop_reason(self) -> str:
        state, budget = self.state, self.budget
        if state.verified:
            return "verified"
        if budget.queries is not None and self.problem.queries + self.verifier.queries >= budget.queries:
            return "queries"
        if budget.seconds is not None and self.seconds >= budget.seconds:
            return "seconds"
        if state.step - state.began >= budget.steps:
            return "steps"  # the last reason, since a restart may follow it
        return ""

    def differentiate(self, view: Evaluation, logits: Tensor, sampled: Sampled) -> Evaluation:
        """The view with the objective and, if the method needs them, gradients, means over the variations of the step.
        `logits` are the scores [1, K] of `evaluate`.
        """
        mean: Parameters = {}
        if self.method.needs_gradient:
            mean = mean_gradients(gradients(self.problem, view, logits), sampled)
        objective = float(self.problem.objective(sampled.answers(logits[0].detach())).mean())
        return replace(view, gradients=mean, objective=objective)

    def advance(self, view: Evaluation) -> None:
        with named(self.name):
            step = self.state.step - self.state.began
            self.state.below_noise = self.method.advance(self.problem, view, step)
        check_count(self.state.below_noise)
        self.state.step += 1

    def restart_if_spent(self) -> None:
        """If a start has taken all its steps, begins the next one, if any, at a random point and with a fresh method.

        Trace, counts and the best perturbation so far are kept.
        """
        state = self.state
        if state.stopped != "steps" or state.restart >= self.restarts or self.fresh is None:
            return
        state.restart, state.step, state.stopped = state.restart + 1, state.step + 1, ""
        state.began, state.below_noise = state.step, 0
        self.problem.restart(state.restart)
        with named(self.name):
            self.method = self.fresh()
        self.start()

    def save_if_due(self) -> None:
        state, self.state.seconds = self.state, self.seconds
        sampled = sampled_error(state, self.problem)
        state.sampled_error = None if sampled is None else (sampled.mean, sampled.share)
        if self.checkpoint_path is not None and monotonic() - self.last_saved > checkpoint.EVERY:
            checkpoint.save(self.checkpoint_path, state, self.problem, self.method, self.verifier)
            self.last_saved = monotonic()


def sampled_error(state: AttackState, problem: AttackProblem) -> ImageError | None:
    """The largest error of the images that were rendered exactly too, in this and earlier processes; None if none was.

    Whether an image is rendered twice depends on its parameters alone, so an attack that was resumed has the same.
    """
    earlier = None if state.sampled_error is None else ImageError(*state.sampled_error)
    own = problem.renderer.sampled_error
    return earlier if own is None else own.or_worse(earlier)


def _rank(row: TraceRow) -> tuple[bool, float, float]:
    """How good a perturbation is to store. Without an expectation it is the advantage alone."""
    if row.share is None or row.objective is None:
        return False, 0.0, -row.advantage
    return row.advantage < 0, row.share, -row.objective
