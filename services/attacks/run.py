"""The loop that runs every attack: evaluate, verify, stop or advance; its state, its verifier and its checkpoint."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from math import sqrt
from pathlib import Path
from time import monotonic
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from services import disk
from services.attacks.goal import ResolvedGoal
from services.attacks.image_differences import ImageDifferences
from services.attacks.method import Method
from services.attacks.problem import (
    AttackProblem,
    Evaluation,
    check_count,
    check_images,
    check_scores,
    check_settings,
    check_state,
    distances,
    gradients,
    quantize,
)
from services.attacks.trace import TraceRow
from services.errors import named
from services.rendering.color import from_bytes, to_bytes
from services.rendering.plan import ImageError
from services.rendering.protocol import Parameters, Renderer
from services.rendering.variation import Variation, noisy, varied
from services.targets.protocol import Target
from services.targets.scores import probability


@dataclass
class AttackState:
    """The loop's state. Together with the method's state it is enough to resume the attack."""

    step: int = 0
    restart: int = 0
    """Number of the present start."""
    began: int = 0
    """The step at which it began."""
    trace: list[TraceRow] = field(default_factory=list)
    settings: dict[str, object] = field(default_factory=dict)
    ever: Tensor = field(default_factory=lambda: torch.zeros(0, 0, dtype=torch.bool))
    """Pixels that were ever truncated, bool [H, W]."""
    below_noise: int = 0
    """The number that `Method.advance` returned last."""
    seconds: float = 0.0
    stopped: str = ""
    fooled: bool = False
    verified: bool = False
    stored_step: int = 0
    sampled_error: tuple[float, float] | None = None
    """The renderer's `sampled_error` until the last checkpoint, mean and share."""
    stored: Parameters = field(default_factory=dict)
    """The perturbation to store: the verified one, else the last that met the goal inside the loop, else the one
    with the smallest advantage."""
    image: Tensor = field(default_factory=lambda: torch.zeros(0, 0, 3, dtype=torch.uint8))
    """The loop's image of the stored perturbation, truncated and rounded, uint8 [H, W, 3]."""
    scores: Tensor = field(default_factory=lambda: torch.zeros(0))
    """The network's scores of that image, [K]."""


@dataclass(frozen=True)
class Sampled:
    """The answers to a perturbation under the variations of a step."""

    logits: Tensor
    """Scores of the images rounded to 8 bits, [samples, K]."""
    gradients: list[Parameters]
    """∂objective/∂perturbation of each, by group; none if no gradient was asked for."""

    def answers(self, of_scene: Tensor) -> Tensor:
        """The scores of the scene itself, [K], and of its variations: [1 + samples, K]."""
        return torch.cat([of_scene[None], self.logits]) if len(self.logits) else of_scene[None]


def sample(problem: AttackProblem, view: Evaluation, gradient: bool) -> Sampled:
    """Asks the network about a perturbation under each variation of the step, with gradients if `gradient`.

    Takes a query and an image for each variation. Raises as `AttackProblem.view` and `AttackProblem.logits` do.
    """
    rows, found = [], []
    for variation in problem.variations:
        with problem.under(variation), torch.set_grad_enabled(gradient):
            own = problem.view(view.perturbation, gradient)
            logits = problem.logits(quantize(own.images)[1])
            if gradient:
                found.append(gradients(problem, own, logits))
        rows.append(logits.detach())
    return Sampled(torch.cat(rows) if rows else torch.zeros(0, len(problem.target.labels)), found)


def mean_gradients(of_scene: Parameters, sampled: Sampled) -> Parameters:
    """The mean of the gradients at the scene itself and at its variations, by group."""
    count = 1 + len(sampled.gradients)
    return {group: sum((one[group] for one in sampled.gradients), own) / count for group, own in of_scene.items()}


@dataclass
class Verifier:
    """Answers for stored perturbations; never sees the loop's own images. Counts what it asks and renders.

    Raises JobFailure for what is no image, and for what are no scores (`contract`).
    """

    renderer: Renderer
    target: Target
    queries: int = 0
    renders: int = 0

    @torch.no_grad()
    def render(self, perturbation: Mapping[str, Tensor], variation: Variation | None = None) -> Tensor:
        """The exact image [H, W, 3] in [0,1], not yet rounded. Groups left out are unperturbed; {} is the original.

        With a variation it is the image of the scene from that view and in that light.
        """
        exact = self.renderer.exact()
        start = exact.initial()
        changed = {g: (start[g] + perturbation[g].to(start[g].dtype))[None] for g in perturbation}
        self.renders += 1
        # always the whole parameter set: the same computation, bit for bit, for every subset of the groups
        parameters = {g: changed.get(g, start[g][None]) for g in exact.groups}
        with named(f"renderer {exact.name!r}"):
            images = exact.render(parameters if variation is None else varied(exact, parameters, variation))
        check_images(exact, images, 1)
        return images[0] if variation is None else noisy(images, variation)[0]

    def image(self, perturbation: Mapping[str, Tensor], variation: Variation | None = None) -> Tensor:
        """The exact image rounded to 8 bits, uint8 [H, W, 3], on the CPU."""
        return to_bytes(self.render(perturbation, variation)).cpu()

    @torch.no_grad()
    def logits(self, image: Tensor) -> Tensor:
        """Scores [K] of an image, uint8 [H, W, 3]. The batch is always of one image, so that no other changes bits."""
        self.queries += 1
        with named(f"target {self.target.name!r}"):
            logits = self.target.logits(from_bytes(image)[None])
        check_scores(self.target, logits, 1)
        return logits[0]

    def fooled(self, perturbation: Mapping[str, Tensor], goal: ResolvedGoal) -> bool:
        """Whether the network's answer to the exact image of the perturbation meets the goal."""
        return bool(goal.fooled(self.logits(self.image(perturbation))))


EVERY = 2.0
"""Seconds between checkpoints."""
COUNTS = 5
"""Counts that a checkpoint keeps."""
_WORDS = "step restart began settings below_noise seconds stopped fooled verified stored_step sampled_error"
_PLAIN = tuple(_WORDS.split())
_BACKENDS = "backends"


def save(path: Path, run: AttackState, problem: AttackProblem, method: Method, verifier: Verifier) -> None:
    """Writes the loop's state, the method's state, and the query and render counts of `problem` and `verifier`."""
    tensors = {f"method.{name}": value for name, value in method.state().items()}
    tensors |= {f"stored.{group}": value for group, value in run.stored.items()}
    tensors |= {"ever": run.ever, "image": run.image, "scores": run.scores}
    words = {name: getattr(run, name) for name in _PLAIN}
    words["trace"] = [row.model_dump() for row in run.trace]
    words["counts"] = [
        problem.queries,
        problem.renders,
        problem.surrogate_queries,
        verifier.queries,
        verifier.renders,
    ]
    words[_BACKENDS] = _backends(problem, verifier)
    with disk.replacing(path) as part:
        # safetensors saves no two tensors that share memory, as a method's may
        save_file(
            {name: value.detach().clone(memory_format=torch.contiguous_format) for name, value in tensors.items()},
            part,
            {"run": json.dumps(words)},
        )


def load(path: Path | None, problem: AttackProblem, method: Method, verifier: Verifier) -> AttackState | None:
    """Returns the saved state of the loop, or None if `path` is None, missing, damaged, of an earlier version, or of
    other backends: a machine whose images differ in their last bits does not go on where another one stopped.

    Also loads the method's state into `method`, and the counts into `problem` and `verifier`. After None the attack
    starts again and ends in the same result.
    """
    if path is None or not path.exists():
        return None
    try:
        with safe_open(path, "pt") as file:
            words = _words(file)
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
    except (SafetensorError, KeyError, ValueError, OSError):
        return None
    if not words.keys() >= {*_PLAIN, _BACKENDS} or len(words["counts"]) != COUNTS:  # an earlier version's
        return None
    if words[_BACKENDS] != _backends(problem, verifier):
        return None
    run = AttackState(**{name: words[name] for name in _PLAIN})
    assert {field.name for field in fields(run)} == {*_PLAIN, "trace", "ever", "stored", "image", "scores"}
    run.trace = [TraceRow(**row) for row in words["trace"]]
    run.ever, run.image, run.scores = tensors["ever"], tensors["image"], tensors["scores"]
    # the file has them sorted by name; the result lists its subsets and shares in the problem's order
    run.stored = {group: tensors[f"stored.{group}"] for group in problem.groups}
    method.load({n.removeprefix("method."): v for n, v in tensors.items() if n.startswith("method.")})
    problem.queries, problem.renders, problem.surrogate_queries, *of_verifier = words["counts"]
    verifier.queries, verifier.renders = of_verifier
    return run


@dataclass(frozen=True)
class Best:
    """The perturbation that an attack would store if it ended at its checkpoint."""

    stored: Parameters
    stored_step: int
    step: int
    """The last step before the checkpoint."""
    queries: int
    """Images that the target had classified by then."""


def best(path: Path) -> Best | None:
    """The best perturbation of a checkpoint; None if there is none or it is damaged."""
    try:
        with safe_open(path, "pt") as file:
            words = _words(file)
            names = [name for name in file.keys() if name.startswith("stored.")]  # noqa: SIM118 - not a mapping
            stored = {name.removeprefix("stored."): file.get_tensor(name) for name in names}
        last = words["trace"][-1]
        return Best(stored, words["stored_step"], last["step"], last["queries"]) if stored else None
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


def _backends(problem: AttackProblem, verifier: Verifier) -> list[str]:
    return [problem.renderer.backend, verifier.renderer.backend, problem.target.backend]


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
            saved = load(self.checkpoint_path, self.problem, self.method, self.verifier)
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
        if self.checkpoint_path is not None and monotonic() - self.last_saved > EVERY:
            save(self.checkpoint_path, state, self.problem, self.method, self.verifier)
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
    if row.share is None:
        return False, 0.0, -row.advantage
    return row.advantage < 0, row.share, -row.objective
