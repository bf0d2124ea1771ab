"""The loop that runs every attack: evaluate, verify, stop or step; what it has come to, its verifier and checkpoint."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import ceil, sqrt
from pathlib import Path
from time import monotonic
from typing import Any, Literal, Self

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from scene_attack import disk
from scene_attack.attacks.attack import Attack, State
from scene_attack.attacks.differences import ImageDifferences
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.problem import (
    AttackProblem,
    Counts,
    Evaluation,
    at_random_start,
    check_images,
    check_scores,
    differentiate,
    distances,
    evaluate,
)
from scene_attack.attacks.square import Square
from scene_attack.attacks.trace import AttackCost, TraceRow
from scene_attack.errors import JobFailure, named, summary
from scene_attack.rendering.color import from_bytes, to_bytes
from scene_attack.rendering.plan import ImageError
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.rendering.variation import Variation, taken, varied
from scene_attack.targets.protocol import Target
from scene_attack.targets.scores import probability

StopReason = Literal["verified", "queries", "seconds", "steps"]

CHECKPOINT_SECONDS = 2.0
"""Seconds between checkpoints."""
DIFFERENCES = "image_differences"
"""Name among a result's settings of those of `ImageDifferences`."""


SEEDS = 8
"""Other seeds under which an adversary's image must meet the goal, where images have noise. The search stops at the
first image that meets it, so that one seed would be in favour of luck; an image that meets it under less than 69 % of
all seeds meets it under these 8 in less than 5 % of the cases."""


@dataclass
class Verifier:
    """The exact path: renders a perturbation afresh, rounds it to 8 bits and asks the network. It never sees the loop's
    images. Groups that a perturbation leaves out are unperturbed; {} is the original.

    Raises JobFailure for what is no image, and for what are no scores.
    """

    renderer: Renderer
    target: Target
    counts: Counts = field(default_factory=Counts)
    """Images rendered and queries made; an attack's problem shares the counts."""

    @classmethod
    def of(cls, problem: AttackProblem) -> Self:
        """The verifier of a problem, which counts with it."""
        return cls(problem.renderer, problem.target, problem.counts)

    @torch.no_grad()
    def render(self, perturbation: Mapping[str, Tensor], variation: Variation | None = None) -> Tensor:
        """The exact image [H, W, 3] in [0,1], not yet rounded.

        With a variation it is the image of the scene from that view and in that light.
        """
        return self._drawn_by(self.renderer.exact(), perturbation, variation)

    def _drawn_by(
        self, exact: Renderer, perturbation: Mapping[str, Tensor], variation: Variation | None = None
    ) -> Tensor:
        start = exact.initial()
        changed = {g: (start[g] + perturbation[g].to(start[g].dtype))[None] for g in perturbation}
        self.counts.renders += 1
        # always the whole parameter set: the same computation, bit for bit, for every subset of the groups
        parameters = {g: changed.get(g, start[g][None]) for g in exact.groups}
        with named(f"renderer {exact.name!r}"):
            images = exact.render(parameters if variation is None else varied(exact, parameters, variation))
        check_images(exact, images, 1)
        return images[0] if variation is None else taken(images, variation)[0]

    def image(self, perturbation: Mapping[str, Tensor], variation: Variation | None = None) -> Tensor:
        """The exact image rounded to 8 bits, uint8 [H, W, 3], on the CPU."""
        return to_bytes(self.render(perturbation, variation)).cpu()

    @torch.no_grad()
    def logits(self, image: Tensor) -> Tensor:
        """Scores [K] of an image, uint8 [H, W, 3]. The batch is always of one image, so that no other changes bits."""
        self.counts.queries += 1
        with named(f"target {self.target.name!r}"):
            logits = self.target.logits(from_bytes(image)[None])
        check_scores(self.target, logits, 1)
        return logits[0]

    def fooled(self, perturbation: Mapping[str, Tensor], goal: ResolvedGoal) -> bool:
        """Whether the network's answer to the exact image of the perturbation meets the goal; where that has noise,
        also to those of all `SEEDS` other seeds.
        """
        return bool(goal.fooled(self.logits(self.image(perturbation)))) and self.holds(perturbation, goal)

    def holds(self, perturbation: Mapping[str, Tensor], goal: ResolvedGoal) -> bool:
        """Whether the goal is met under every other seed, up to the first under which it is not; true where images have
        no noise.
        """
        return all(bool(goal.fooled(self.logits(to_bytes(image)))) for image in self.reseeded(perturbation))

    def reseeded(self, perturbation: Mapping[str, Tensor]) -> Iterator[Tensor]:
        """The exact images [H, W, 3] of a perturbation under `SEEDS` other seeds, on the CPU; none where images have no
        noise.
        """
        for number in range(1, SEEDS + 1):
            other = self.renderer.exact().reseeded(number)
            if other is not None:
                yield self._drawn_by(other, perturbation).cpu()


CONFIRMING = 16
"""Variations, of the last steps, that end an attack over a range if the goal is met under all: where it is met under
less than 83 % of the range, all of 16 meet it by chance in less than 5 % of the cases."""


@dataclass(frozen=True)
class Best:
    """The perturbation to store: the verified one, else the last that met the goal inside the loop, else the one with
    the smallest advantage. With an expectation it is the one by which the goal was met under most of the last
    `CONFIRMING` variations.
    """

    step: int
    delta: Tensor
    """[total]"""
    saved: Tensor
    """The loop's image of it, truncated and rounded, uint8 [H, W, 3]."""
    scores: Tensor
    """The network's scores of that image, [K]."""


@dataclass
class AttackRun:
    """Progress of an attack. All but its first five fields and the clock is in the checkpoint.

    `begin_or_resume` makes one, `run_attack` runs it.
    """

    problem: AttackProblem
    attack: Attack
    verifier: Verifier
    """Shares `counts` with the problem."""
    checkpoint: Path | None = None
    on_row: Callable[[TraceRow], None] = lambda _: None
    state: State = field(default_factory=dict)
    settings: dict[str, object] = field(default_factory=dict)
    """The settings that were found by measuring, as JSON."""
    step: int = 0
    restart: int = 0
    """Number of the present start."""
    trace: list[TraceRow] = field(default_factory=list)
    below_noise: int = 0
    """Number of estimates below the noise in the last step, or of groups whose gradient is zero."""
    ever_truncated: Tensor = field(default_factory=lambda: torch.zeros(0, 0, dtype=torch.bool))
    """Pixels that were ever truncated, bool [H, W]."""
    best: Best | None = None
    fooled: bool = False
    """Whether the goal was ever met inside the loop."""
    verified: bool = False
    stopped: StopReason | None = None
    earlier_error: ImageError | None = None
    """The renderer's `sampled_error` in earlier processes."""
    began: float = field(default_factory=monotonic)
    """Start that a run without interruptions would have had, seconds of the monotonic clock; `last_saved` likewise."""
    last_saved: float = field(default_factory=monotonic)

    @classmethod
    def begin_or_resume(
        cls,
        problem: AttackProblem,
        attack: Attack,
        verifier: Verifier,
        checkpoint: Path | None = None,
        on_row: Callable[[TraceRow], None] = lambda _: None,
    ) -> Self:
        """The attack as it was when the file `checkpoint` was written, or before its first step if there is no such
        file or it cannot be used (`load`). The settings that it measures are measured once. Raises ValueError unless
        problem and verifier share their counts.
        """
        if verifier.counts is not problem.counts:
            raise ValueError("the queries of the problem and of the verifier must be counted together: share `counts`")
        run = cls(problem, attack, verifier, checkpoint, on_row)
        run.ever_truncated = torch.zeros(problem.renderer.size, dtype=torch.bool)
        needs_differences = attack.needs_gradient and not problem.renderer.differentiable
        if checkpoint is not None and load(checkpoint, run):
            if needs_differences:
                measured: Any = run.settings[DIFFERENCES]
                differences = ImageDifferences.at(problem, measured["delta"], keeps_metric=attack.needs_metric)
                run.problem = replace(run.problem, differences=differences)
            return run
        if needs_differences:
            differences = ImageDifferences.measure(problem, keeps_metric=attack.needs_metric)
            run.problem = replace(problem, differences=differences)
        run.begin()
        with named(run.name):
            run.settings = attack.measured(run.problem, run.state)
            check_settings(run.settings)
        if needs_differences:
            run.settings = run.settings | {DIFFERENCES: differences.settings(problem)}
        return run

    @property
    def name(self) -> str:
        """The attack in errors."""
        return f"method {self.attack.method!r}"

    @property
    def seconds(self) -> float:
        """Run time so far, over all processes."""
        return monotonic() - self.began

    @property
    def own_step(self) -> int:
        """Steps of the present start."""
        return self.step - self.problem.first_step

    @property
    def stored(self) -> Parameters:
        """The best perturbation, by group."""
        assert self.best is not None
        return self.problem.layout.unflatten(self.best.delta)

    def cost(self) -> AttackCost:
        """The cost until now. `seconds` is that of the last row of the trace."""
        counts = self.problem.counts
        return AttackCost(
            steps=self.step,
            queries=counts.queries,
            surrogate_queries=counts.surrogate_queries,
            renders=counts.renders,
            truncated=int(self.ever_truncated.sum()),
            seconds=self.trace[-1].seconds,
        )

    @property
    def sampled_error(self) -> ImageError | None:
        """The largest error of the images that were rendered exactly too, in all processes; None if none was.

        Whether an image is rendered twice depends on its parameters alone, so an attack that was resumed has the same.
        """
        own = self.problem.renderer.sampled_error
        return self.earlier_error if own is None else own.or_worse(self.earlier_error)

    def begin(self) -> None:
        """Begins the present start."""
        with named(self.name):
            self.state = self.attack.init(self.problem)
            check_state(self.state)

    def record(self, evaluation: Evaluation) -> None:
        """Adds a row to the trace, keeps the best perturbation, and verifies one whose image meets the goal.

        With an expectation the goal must be met under all of the last `CONFIRMING` variations. Truncation makes image
        and scene disagree: the verifier may refuse what fooled the network here, and the attack then goes on.
        """
        fooled = bool(self.problem.goal.fooled(evaluation.scores))
        row = self.row(evaluation)
        self.trace.append(row)
        self.ever_truncated |= evaluation.truncated.cpu()
        if self.replaces_best(fooled):
            detached = evaluation.detached()
            self.best = Best(
                self.step, detached.delta.clone(), detached.saved.cpu().clone(), detached.scores.cpu().clone()
            )
        self.fooled |= fooled
        if fooled and (row.share is None or self.confirmed(self.step) == 1.0):
            self.verified = self.verifier.fooled(self.stored, self.problem.goal)
        self.on_row(row)
        self.stopped = self.stop_reason()

    def replaces_best(self, fooled: bool) -> bool:
        """Whether the perturbation of the last row is to be stored in place of the best so far."""
        if self.best is None:
            return True
        better = self.rank(self.step) >= self.rank(self.best.step)
        if self.trace[self.step].share is not None:
            return better
        return fooled or (better and not self.fooled)

    def rank(self, step: int) -> tuple[bool, float, float]:
        """The quality of a step's perturbation as a sort key. Without an expectation it is the advantage alone."""
        row = self.trace[step]
        if row.share is None:
            return False, 0.0, -row.advantage
        return row.advantage < 0, self.confirmed(step), -row.objective

    def confirmed(self, step: int) -> float:
        """The share of the last `CONFIRMING` variations under which the goal was met: those of the step and of those
        before it in the same start. What is missing at its beginning counts as not met."""
        assert self.problem.expectation is not None
        steps = ceil(CONFIRMING / self.problem.expectation.samples)
        rows = [
            row for row in self.trace[max(0, step + 1 - steps) : step + 1] if row.restart == self.trace[step].restart
        ]
        return sum(row.share or 0.0 for row in rows) / steps

    def row(self, evaluation: Evaluation) -> TraceRow:
        """The trace's row of an evaluation."""
        problem, goal, scores = self.problem, self.problem.goal, evaluation.scores.detach()
        minimised = problem.objective if self.attack.needs_gradient else goal.advantage
        height, width = problem.renderer.size
        distance = float(distances(evaluation.image.detach(), problem.original)[0])
        label = int(scores.argmax())
        samples = evaluation.answers[1:]
        return TraceRow(
            step=self.step,
            restart=self.restart,
            loss=float(goal.loss(scores)),
            label=problem.target.labels[label],
            confidence=float(probability(scores, label)),
            advantage=float(goal.advantage(scores)),
            objective=float(minimised(evaluation.answers).mean()) + problem.distance_weight * distance**2,
            share=float(goal.fooled(samples).double().mean()) if len(samples) else None,
            distance=distance,
            perceptibility=distance / sqrt(height * width),
            truncated=int(evaluation.truncated.sum()),
            below_noise=self.below_noise,
            queries=problem.counts.queries,
            surrogate_queries=problem.counts.surrogate_queries,
            renders=problem.counts.renders,
            seconds=self.seconds,
        )

    def stop_reason(self) -> StopReason | None:
        """Why the attack stops now; None if it goes on."""
        attack = self.attack
        if self.verified:
            return "verified"
        if attack.queries is not None and self.problem.counts.queries >= attack.queries:
            return "queries"
        if attack.seconds is not None and self.seconds >= attack.seconds:
            return "seconds"
        return "steps" if self.own_step >= attack.steps else None  # the last reason, since a restart may follow it

    def advance(self, evaluation: Evaluation) -> None:
        """Takes one step of the attack."""
        if self.attack.needs_gradient:
            evaluation = differentiate(self.problem, evaluation)
        objective = float(self.problem.objective(evaluation.answers).mean())
        evaluation = replace(evaluation.detached(), objective=objective)
        with named(self.name):
            self.state = self.attack.step(self.problem, self.state, evaluation)
            check_state(self.state)
            self.below_noise = below_noise(self.problem, self.state, evaluation)
        self.step += 1

    def restart_if_spent(self) -> None:
        """If a start has taken all its steps, begins the next one, if any, at a random point.

        Trace, counts and the best perturbation so far are kept.
        """
        if self.stopped != "steps" or self.restart >= self.attack.restarts:
            return
        self.restart, self.step, self.stopped, self.below_noise = self.restart + 1, self.step + 1, None, 0
        self.problem = at_random_start(self.problem, self.restart, self.step)
        self.begin()

    def save_if_due(self) -> None:
        """Writes the checkpoint, if there is to be one, every few seconds."""
        if self.checkpoint is not None and monotonic() - self.last_saved > CHECKPOINT_SECONDS:
            save(self.checkpoint, self)
            self.last_saved = monotonic()


def run_attack(run: AttackRun) -> AttackRun:
    """Attacks until an adversary is verified or the budget is spent, and returns `run`.

    At every step the network classifies the image rounded to 8 bits. If the goal is met, the verifier renders the
    perturbation by the exact path and asks the network again. The loop ends if that image meets the goal too, and goes
    on otherwise. `attack.steps` is the limit of each start, `attack.queries` counts every image that the network
    classifies, verification included, and `attack.seconds` is wall-clock time over all processes.

    Raises JobFailure("non-finite") if an image, a score or a gradient is not finite, JobFailure("internal") if
    renderer, target or attack break their protocol, and what `problem.interrupt` raises.
    """
    while run.stopped is None:
        delta = run.state["delta"]
        evaluation = evaluate(run.problem, delta, run.own_step, gradient=run.attack.needs_gradient)
        run.record(evaluation)
        if run.stopped is None:
            run.advance(evaluation)
        run.restart_if_spent()
        run.save_if_due()
    return run


def check_masking(run: AttackRun, queries: int) -> dict[str, object]:
    """The alarm for masked gradients: attacks the problem of a run that held by Square, which needs no gradient, with
    at most `queries` steps and within the same limits. Returns its outcome.

    `square` is "fooled" if it found a verified adversary, else "held"; `queries` is the number of its steps. Where
    Square succeeds, the gradient misled the run. What it takes is counted with the run's. Raises as `run_attack` does.
    """
    problem = replace(run.problem, loss="margin", start=run.problem.nothing, first_step=0)
    attack = Square.model_construct(epsilon=dict(problem.limits.epsilon), steps=queries)
    square = AttackRun.begin_or_resume(problem, attack, run.verifier)
    run_attack(square)
    return {"square": "fooled" if square.verified else "held", "queries": square.step}


def below_noise(problem: AttackProblem, state: State, evaluation: Evaluation) -> int:
    """The count of the state's `below_noise`, or of groups whose gradient is zero throughout."""
    if "below_noise" in state:
        return int(state["below_noise"])
    if evaluation.gradient is None:
        return 0
    groups = problem.layout.unflatten(evaluation.gradient).values()
    return sum(bool(gradient.min() == gradient.max() == 0) for gradient in groups)


def check_settings(settings: object) -> None:
    """Raises JobFailure unless `Attack.measured` returned a dict that can be stored as JSON."""
    try:
        if isinstance(settings, dict):
            json.dumps(settings, allow_nan=False)
            return
    except (TypeError, ValueError) as error:
        raise JobFailure("internal", f"the settings that the attack measured are not JSON: {summary(error)}") from error
    raise JobFailure("internal", f"the attack's `measured` returned a {type(settings).__name__}; a dict is due")


def check_state(state: object) -> None:
    """Raises JobFailure unless `state` is tensors by name, which a checkpoint can save, and has a `delta`."""
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise JobFailure("internal", "the attack's state is no dict of tensors; a checkpoint could not save it")
    if "delta" not in state:
        raise JobFailure("internal", "the attack's state has no `delta`, its perturbation")


# The checkpoint: one safetensors file, replaced atomically


def save(path: Path, run: AttackRun) -> None:
    """Writes how far the attack has come."""
    tensors = {f"state.{name}": value for name, value in run.state.items()} | {"ever_truncated": run.ever_truncated}
    words: dict[str, Any] = {name: getattr(run, name) for name in _PLAIN}
    if run.best is not None:
        words["best_step"] = run.best.step
        tensors |= {f"best.{name}": getattr(run.best, name) for name in ("delta", "saved", "scores")}
    error = run.sampled_error
    words |= {
        "first_step": run.problem.first_step,
        "seconds": run.seconds,
        "trace": [row.model_dump() for row in run.trace],
        "counts": vars(run.problem.counts),
        "error": None if error is None else (error.mean, error.share),
        "layout": {group: list(shape) for group, shape in run.problem.layout.shapes.items()},
        "backends": _backends(run),
    }
    with disk.replacing(path) as part:
        # safetensors saves no two tensors that share memory, as a state's may
        save_file(
            {name: value.detach().clone(memory_format=torch.contiguous_format) for name, value in tensors.items()},
            part,
            {"run": json.dumps(words)},
        )


_PLAIN = ("step", "restart", "settings", "below_noise", "stopped", "fooled", "verified")


def load(path: Path, run: AttackRun) -> bool:
    """Takes an attack up where a checkpoint left it, with its counts. Returns False, and changes nothing, for a file
    that is missing, damaged, of another version, or of other backends: a machine whose images differ in their last bits
    does not go on where another one stopped. The attack then starts again and ends in the same result.
    """
    try:
        with safe_open(path, "pt") as file:
            words = _words(file)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
        if words["backends"] != _backends(run):
            return False
        plain = {name: words[name] for name in _PLAIN}
        best = Best(words["best_step"], *(tensors[f"best.{name}"] for name in ("delta", "saved", "scores")))
        trace, counts, problem = [TraceRow(**row) for row in words["trace"]], Counts(**words["counts"]), run.problem
        for number in range(1, words["restart"] + 1):
            problem = at_random_start(problem, number, words["first_step"])
        error = None if words["error"] is None else ImageError(*words["error"])
        ever_truncated, began = tensors["ever_truncated"], monotonic() - words["seconds"]
    except (SafetensorError, KeyError, TypeError, ValueError, OSError):
        return False
    vars(run).update(plain, best=best, trace=trace, problem=problem, earlier_error=error, began=began)
    run.ever_truncated = ever_truncated
    run.state = {name.removeprefix("state."): v for name, v in tensors.items() if name.startswith("state.")}
    vars(problem.counts).update(vars(counts))
    return True


@dataclass(frozen=True)
class UnfinishedBest:
    """The perturbation that an attack would store if it ended at its checkpoint."""

    stored: Parameters
    stored_step: int
    step: int
    """The last step before the checkpoint."""
    queries: int
    """Images that the target had classified by then."""


def best(path: Path) -> UnfinishedBest | None:
    """The best perturbation of a checkpoint; None if there is none or it is damaged."""
    try:
        with safe_open(path, "pt") as file:
            words, delta = _words(file), file.get_tensor("best.delta")
        shapes = [torch.Size(shape) for shape in words["layout"].values()]
        parts = delta.split([shape.numel() for shape in shapes])
        stored = {g: part.reshape(shape) for g, part, shape in zip(words["layout"], parts, shapes, strict=True)}
        last = words["trace"][-1]
        return UnfinishedBest(stored, words["best_step"], last["step"], last["queries"])
    except (SafetensorError, LookupError, ValueError, OSError):
        return None


def saved_step(path: Path) -> int:
    """The step that a checkpoint was saved at; -1 if there is none or it is damaged."""
    try:
        with safe_open(path, "pt") as file:
            return int(_words(file)["step"])
    except (SafetensorError, KeyError, ValueError, OSError):
        return -1


def _words(file: Any) -> dict[str, Any]:
    words: dict[str, Any] = json.loads((file.metadata() or {})["run"])
    return words


def _backends(run: AttackRun) -> list[str]:
    return [run.problem.renderer.backend, run.verifier.renderer.backend, run.problem.target.backend]
