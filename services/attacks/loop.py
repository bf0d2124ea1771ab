"""The loop that runs every attack: evaluate, verify, stop or advance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
from services.attacks.problem import AttackProblem, Evaluation, ask, distances, gradients
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


@dataclass
class AttackRun:
    """One attack as the loop runs it.

    The loop resumes from the file `checkpoint_path` if it holds a readable checkpoint, and writes it every few seconds.
    It calls `on_row` with every new row of the trace. A start that took all its steps is followed by up to `restarts`
    others, whose methods `fresh` makes.
    """

    problem: AttackProblem
    method: Method
    verifier: Verifier
    budget: Budget
    checkpoint_path: Path | None = None
    on_row: Callable[[TraceRow], None] = lambda _: None
    restarts: int = 0
    fresh: Callable[[], Method] | None = None


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
    on otherwise (truncation makes image and parameters disagree). Raises JobFailure("non-finite") if an image, a score
    or a gradient is not finite, JobFailure("internal") if renderer, target or method break their protocol (`contract`),
    and what `problem.interrupt` raises.
    """
    [found] = run_together([AttackRun(problem, method, verifier, budget, checkpoint_path, on_row, restarts, fresh)])
    return found


def run_together(attacks: Sequence[AttackRun]) -> list[AttackState]:
    """Runs several attacks in lockstep, with one pass of the network per step for all; returns states in their order.

    Raises ValueError unless they share the network, the question, the size of the images and whether the method needs
    gradients. Each attack ends at its own step, with the result it would have alone, except for the rounding of the
    network's sums, which depends on the batch size. An error in one attack ends all.
    """
    shared = {
        (id(a.problem.target), a.problem.question, a.problem.renderer.size, a.method.needs_gradient) for a in attacks
    }
    if len(shared) > 1:
        raise ValueError("attacks that run together share network, question, size of image and need of gradients")
    running = [_Running(attack) for attack in attacks]
    while active := [one for one in running if not one.run.stopped]:
        _step(active)
    return [one.run for one in running]


class _Running:
    """An attack and its state."""

    def __init__(self, attack: AttackRun) -> None:
        self.attack = attack
        self.name = f"method {type(attack.method).__name__!r}"
        with named(self.name):
            found = checkpoint.load(attack.checkpoint_path, attack.problem, attack.method, attack.verifier)
        self.run = found or AttackState(ever=torch.zeros(attack.problem.renderer.size, dtype=torch.bool))
        for number in range(1, self.run.restart + 1):
            attack.problem.restart(number)
        self.began, self.last_saved = monotonic() - self.run.seconds, monotonic()
        resumed = bool(self.run.settings or self.run.trace)
        measured = self._differences(resumed)
        if not resumed:
            self.run.settings = self.start() | measured

    def _differences(self, resumed: bool) -> dict[str, object]:
        """Prepares differences of images if the method needs gradients through a renderer that has none. Returns their
        settings as `image_differences`, from which a resumed attack takes them.
        """
        problem = self.attack.problem
        if problem.renderer.differentiable or not self.attack.method.needs_gradient:
            return {}
        if resumed:
            settings: Any = self.run.settings[DIFFERENCES]
            differences = ImageDifferences.load(problem, settings)
        else:
            differences = ImageDifferences.measure(problem)
        problem.differences = differences
        return {DIFFERENCES: differences.settings(problem)}

    @property
    def seconds(self) -> float:
        return monotonic() - self.began

    def start(self) -> dict[str, object]:
        """Starts the method. Returns the settings that it measured."""
        self.attack.problem.draw(self.run.step)
        with named(self.name):
            settings = self.attack.method.start(self.attack.problem)
            check_state(self.attack.method.state())
        check_settings(settings)
        return settings

    def restart(self) -> None:
        """If a start has taken all its steps, begins the next one, if any, at a random point and with a fresh method.

        Trace, counts and the best perturbation so far are kept.
        """
        attack, state = self.attack, self.run
        if state.stopped != "steps" or state.restart >= attack.restarts or attack.fresh is None:
            return
        state.restart, state.step, state.stopped = state.restart + 1, state.step + 1, ""
        state.began, state.below_noise = state.step, 0
        attack.problem.restart(state.restart)
        with named(self.name):
            attack.method = attack.fresh()
        self.start()

    def view(self) -> Evaluation:
        method = self.attack.method
        self.attack.problem.draw(self.run.step)
        with named(self.name):
            perturbation = method.perturbation
        return self.attack.problem.view(perturbation, gradient=method.needs_gradient)

    def record(self, view: Evaluation, image: Tensor, logits: Tensor, sampled: Sampled) -> None:
        """Records an evaluation, its image as saved (uint8 [H, W, 3]) and the scores [K]; verifies; may stop.

        With an expectation an attack is verified only once the answers to all variations of a step meet the goal too.
        """
        attack, state = self.attack, self.run
        problem, verifier = attack.problem, attack.verifier
        row = _row(attack, view, logits, sampled, state, self.seconds)
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
        attack.on_row(row)
        state.stopped = _stop(problem, verifier, state, attack.budget, self.seconds)

    def advance(self, view: Evaluation) -> None:
        with named(self.name):
            step = self.run.step - self.run.began
            self.run.below_noise = self.attack.method.advance(self.attack.problem, view, step)
        check_count(self.run.below_noise)
        self.run.step += 1

    def save(self) -> None:
        attack, self.run.seconds = self.attack, self.seconds
        sampled = sampled_error(self.run, attack.problem)
        self.run.sampled_error = None if sampled is None else (sampled.mean, sampled.share)
        if attack.checkpoint_path is not None and monotonic() - self.last_saved > checkpoint.EVERY:
            checkpoint.save(attack.checkpoint_path, self.run, attack.problem, attack.method, attack.verifier)
            self.last_saved = monotonic()


def sampled_error(state: AttackState, problem: AttackProblem) -> ImageError | None:
    """The largest error of the images that were rendered exactly too, in this and earlier processes; None if none was.

    Whether an image is rendered twice depends on its parameters alone, so an attack that was resumed has the same.
    """
    earlier = None if state.sampled_error is None else ImageError(*state.sampled_error)
    own = problem.renderer.sampled_error
    return earlier if own is None else own.or_worse(earlier)


def _step(active: list[_Running]) -> None:
    needs_gradient = active[0].attack.method.needs_gradient
    problems, views = [one.attack.problem for one in active], [one.view() for one in active]
    with torch.set_grad_enabled(needs_gradient):
        images, shown = quantize(torch.cat([view.images for view in views]) if len(views) > 1 else views[0].images)
        logits = ask(problems, shown)
    sampled = [sample(p, view, needs_gradient) for p, view in zip(problems, views, strict=True)]
    for one, view, image, scores, own in zip(active, views, images, logits.detach(), sampled, strict=True):
        one.record(view, image, scores, own)
    going = [i for i, one in enumerate(active) if not one.run.stopped]
    found: list[Parameters] = [{}] * len(going)
    if needs_gradient and going:
        found = gradients([problems[i] for i in going], [views[i] for i in going], logits[going])
    for i, of in zip(going, found, strict=True):
        value = float(problems[i].objective(sampled[i].answers(logits[i].detach())).mean())
        mean = mean_gradients(of, sampled[i]) if needs_gradient else of
        active[i].advance(replace(views[i], gradients=mean, objective=value))
    for one in active:
        one.restart()
        one.save()


def _rank(row: TraceRow) -> tuple[bool, float, float]:
    """How good a perturbation is to store. Without an expectation it is the advantage alone."""
    if row.share is None or row.objective is None:
        return False, 0.0, -row.advantage
    return row.advantage < 0, row.share, -row.objective


def _row(
    attack: AttackRun, view: Evaluation, logits: Tensor, sampled: Sampled, state: AttackState, seconds: float
) -> TraceRow:
    problem, verifier = attack.problem, attack.verifier
    minimised = problem.objective if attack.method.needs_gradient else problem.goal.advantage
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
        seconds=seconds,
    )


def _stop(problem: AttackProblem, verifier: Verifier, state: AttackState, budget: Budget, seconds: float) -> str:
    if state.verified:
        return "verified"
    if budget.queries is not None and problem.queries + verifier.queries >= budget.queries:
        return "queries"
    if budget.seconds is not None and seconds >= budget.seconds:
        return "seconds"
    if state.step - state.began >= budget.steps:
        return "steps"  # the last reason, since a restart may follow it
    return ""
