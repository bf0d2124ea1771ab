"""The one loop all attacks run in: look, judge, stop or advance."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

import torch
from torch import Tensor

from services.attacks import checkpoint
from services.attacks.exact import Judge
from services.attacks.method import Method
from services.attacks.problem import Problem, View
from services.attacks.trace import TraceRow
from services.rendering.display import as_saved, to_bytes
from services.rendering.protocol import Parameters
from services.targets.scores import probability


@dataclass(frozen=True)
class Budget:
    """When to stop without success. Queries count every picture put to the network, verification included."""

    steps: int
    queries: int | None = None
    seconds: float | None = None


@dataclass
class Run:
    """All that a loop has gathered; with the method's state, all it needs to go on."""

    step: int = 0
    trace: list[TraceRow] = field(default_factory=list)
    settings: dict[str, object] = field(default_factory=dict)
    ever: Tensor = field(default_factory=lambda: torch.zeros(0, 0, dtype=torch.bool))
    """Pixels that were ever truncated, bool [H, W]."""
    flat: int = 0
    seconds: float = 0.0
    stopped: str = ""
    fooled: bool = False
    verified: bool = False
    stored_step: int = 0
    stored: Parameters = field(default_factory=dict)
    """The perturbation that counts: the verified one, else the last that fooled the loop, else the last."""
    picture: Tensor = field(default_factory=lambda: torch.zeros(0, 0, 3, dtype=torch.uint8))
    """The loop's own picture of it, uint8 [H, W, 3]."""


def run(
    problem: Problem,
    method: Method,
    judge: Judge,
    budget: Budget,
    *,
    saved: Path | None = None,
    on_row: Callable[[TraceRow], None] = lambda _: None,
) -> Run:
    """Attacks until an adversary is verified or the budget is spent.

    At every step the picture, as it would be saved, is put to the network. If that fools it, the perturbation is
    rendered afresh by the exact path; the loop ends when that fools the network too, and goes on otherwise (truncation
    makes picture and parameters disagree). `saved` is a checkpoint: resumed from if it fits, written every few seconds.
    """
    state = checkpoint.load(saved, problem, method, judge) or Run(
        ever=torch.zeros(problem.renderer.size, dtype=torch.bool)
    )
    began, last_saved = monotonic() - state.seconds, monotonic()
    if not state.settings and not state.trace:
        state.settings = method.start(problem)
    while not state.stopped:
        view = problem.view(method.perturbation, gradient=method.needs_gradient)
        fooled, row = _look(problem, judge, view, state, monotonic() - began)
        _keep(problem, judge, view, state, fooled)
        state.trace.append(row)
        on_row(row)
        state.stopped = _stop(problem, judge, state, budget, monotonic() - began)
        if not state.stopped:
            state.flat = method.advance(problem, view, state.step)
            state.step += 1
        state.seconds = monotonic() - began
        if saved is not None and monotonic() - last_saved > checkpoint.EVERY:
            checkpoint.save(saved, state, problem, method, judge)
            last_saved = monotonic()
    return state


def _look(problem: Problem, judge: Judge, view: View, state: Run, seconds: float) -> tuple[bool, TraceRow]:
    with torch.no_grad():
        logits = problem.logits(as_saved(view.images))
        change = (view.images - problem.original).double()
        label = int(logits[0].argmax())
        row = TraceRow(
            step=state.step,
            loss=float(problem.goal.loss(logits)),
            label=problem.target.labels[label],
            confidence=float(probability(logits, label)),
            advantage=float(problem.goal.advantage(logits)),
            distance=float(change.square().sum().sqrt()),
            perceptibility=float(change.square().sum(dim=-1).mean().sqrt()),
            truncated=int(view.truncated.sum()),
            flat=state.flat,
            queries=problem.queries + judge.queries,
            renders=problem.renders + judge.renders,
            seconds=seconds,
        )
        return bool(problem.goal.fooled(logits)), row


def _keep(problem: Problem, judge: Judge, view: View, state: Run, fooled: bool) -> None:
    state.ever |= view.truncated
    if fooled or not state.fooled:
        state.stored = {g: v.detach().clone() for g, v in view.perturbation.items()}
        state.stored_step = state.step
        state.picture = to_bytes(view.images)[0]
    if fooled:
        state.fooled = True
        state.verified = judge.fooled(state.stored, problem.goal)


def _stop(problem: Problem, judge: Judge, state: Run, budget: Budget, seconds: float) -> str:
    if state.verified:
        return "verified"
    if state.step >= budget.steps:
        return "steps"
    if budget.queries is not None and problem.queries + judge.queries >= budget.queries:
        return "queries"
    if budget.seconds is not None and seconds >= budget.seconds:
        return "seconds"
    return ""
