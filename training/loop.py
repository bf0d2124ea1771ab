"""The training loop of all networks: steps, a learning-rate schedule, and a checkpoint to resume from.

What a step does follows from the seed, its number, its progress and the state before it alone, so a training whose
progress follows from the steps ends in the same bits if it is killed and resumed.
"""

import io
import pickle
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, pi
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from scene_attack import disk
from scene_attack.errors import InvalidRequest, summary

CHECKPOINT_SECONDS = 120.0
"""Time between checkpoints."""
REPORT_STEPS = 20
"""Steps between reports; losses are means over them."""
Said = Callable[[str, float, float, str], None]
"""Gets the name of a stage, the amount done, the total, and more words."""


@dataclass(frozen=True)
class Schedule:
    """Settings of a training of so many steps.

    rate: the peak learning rate. warm_up: the share of the steps in which it rises. decay: AdamW's weight decay of
    matrices. clip: the largest norm of a gradient.
    """

    steps: int
    rate: float
    warm_up: float = 0.05
    decay: float = 0.0
    clip: float = 5.0

    def progress(self, step: int, _: float) -> float:
        """The share of the steps that are taken."""
        return step / self.steps

    def rate_at(self, step: int, _: float) -> float:
        """Returns the learning rate of a step: a linear rise, then half a cosine down to 0."""
        rise = max(1.0, self.warm_up * self.steps)
        if step < rise:
            return self.rate * (step + 1) / (rise + 1)
        return self.rate * 0.5 * (1 + cos(pi * (step - rise) / max(1.0, self.steps - rise)))


@dataclass(frozen=True)
class Report:
    """Progress of training. losses: means over the steps since the last report. rate: steps per second of this run."""

    step: int
    progress: float
    losses: dict[str, float]
    rate: float


Step = Callable[[float, np.random.Generator], tuple[Tensor, dict[str, float]]]
"""Returns the loss of a step and its parts, at a progress in [0, 1), with choices of a generator of the step's own."""


class TrainingLoop:
    """A training of a module that can be resumed from its checkpoint file; `seconds` is how long its steps took."""

    def __init__(
        self, module: nn.Module, path: Path, about: dict[str, Any], seed: Sequence[int], decay: float, clip: float
    ) -> None:
        """Begins, or goes on from the checkpoint at `path` if there is one. `about` names the training.

        decay: AdamW's weight decay of matrices. clip: the largest norm of a gradient. Raises InvalidRequest("--out") if
        that checkpoint is damaged, or of another training.
        """
        self.module, self.step, self.seconds = module, 0, 0.0
        self._seed, self._clip = seed, clip
        self.notes: dict[str, Any] = {}
        """Beside the state in the checkpoint; not resumed from."""
        self._path, self._about = path, about
        matrices = [p for p in module.parameters() if p.dim() > 1]
        others = [p for p in module.parameters() if p.dim() <= 1]
        groups = [{"params": matrices, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]
        self._optimiser = torch.optim.AdamW(groups, foreach=True)
        if path.exists():
            state = read(path)
            if state["about"] != about:
                why = f"{path} is a checkpoint of {state['about']}, not of {about}; move it away"
                raise InvalidRequest("--out", why)
            module.load_state_dict(state["module"])
            self._optimiser.load_state_dict(state["optimiser"])
            self.step, self.seconds = state["step"], state["seconds"]

    def run(
        self,
        progress_at: Callable[[int, float], float],
        rate_at: Callable[[int, float], float],
        loss: Step,
        said: Callable[[Report], None],
        stop: Callable[[int], bool] = lambda _: False,
    ) -> None:
        """Takes the steps that are left, with a checkpoint every few minutes and at the end.

        `progress_at`, of a step's number and the seconds of training so far, is the progress before the step; at 1 the
        training is over. `rate_at`, of the number and that progress, is the learning rate. `said` gets a report every
        few steps. `stop` is asked after each step, with its number, whether to end early, without a checkpoint.
        """
        began = saved = last = time.monotonic()
        first, losses = self.step, []
        self.module.train()
        while (progress := progress_at(self.step, self.seconds)) < 1:
            losses.append(self._take(loss, progress, rate_at(self.step, progress)))
            self.step += 1
            now = time.monotonic()
            self.seconds, last = self.seconds + now - last, now
            if self.step % REPORT_STEPS == 0:
                means = {name: float(np.mean([row[name] for row in losses])) for name in losses[0]}
                said(Report(self.step, progress, means, (self.step - first) / (now - began)))
                losses = []
            if now - saved > CHECKPOINT_SECONDS:
                self.save()
                saved = now
            if stop(self.step):
                return
        self.save()

    def save(self) -> None:
        """Writes the checkpoint: after a kill the file is the old or the new one, complete."""
        state = {"about": self._about, "module": self.module.state_dict(), "optimiser": self._optimiser.state_dict()}
        buffer = io.BytesIO()
        torch.save(state | {"step": self.step, "seconds": self.seconds, "notes": self.notes}, buffer)
        disk.write(self._path, buffer.getvalue())

    def _take(self, loss: Step, progress: float, rate: float) -> dict[str, float]:
        """Takes one step; returns the parts of its loss."""
        total, parts = loss(progress, np.random.default_rng([*self._seed, self.step]))
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        self._optimiser.zero_grad()
        total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.module.parameters(), self._clip)
        self._optimiser.step()
        return parts


def read(path: Path) -> dict[str, Any]:
    """Returns the state in a checkpoint. Raises InvalidRequest("--out") if it is damaged."""
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
    except (RuntimeError, EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
        why = f"{path} is damaged ({summary(error)}); delete it, and that part is trained anew"
        raise InvalidRequest("--out", why) from error
    return state
