"""The training loop of all parts of IEP: steps, a learning-rate schedule, and a checkpoint to resume from.

What a step does follows from the seed, the step's number and the state before it alone, so a training that is killed
and resumed ends in the same bits.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import cos, pi
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from training import checkpoints

CHECKPOINT_SECONDS = 120.0
"""Time between checkpoints."""
REPORT_STEPS = 50
"""Steps between reports; losses are means over them."""


@dataclass(frozen=True)
class Schedule:
    """Settings of the training of a part.

    rate: the peak learning rate. warm_up: the share of the steps in which it rises. decay: AdamW's weight decay of
    matrices. clip: the largest norm of a gradient.
    """

    steps: int
    rate: float
    warm_up: float = 0.05
    decay: float = 0.0
    clip: float = 5.0

    def rate_at(self, step: int) -> float:
        """Returns the learning rate of a step: a linear rise, then half a cosine down to 0."""
        rise = max(1.0, self.warm_up * self.steps)
        if step < rise:
            return self.rate * (step + 1) / (rise + 1)
        return self.rate * 0.5 * (1 + cos(pi * (step - rise) / max(1.0, self.steps - rise)))


@dataclass(frozen=True)
class Report:
    """Progress of training. losses: means over the steps since the last report. rate: steps per second of this run."""

    step: int
    of: int
    losses: dict[str, float]
    rate: float


Step = Callable[[float, np.random.Generator], tuple[Tensor, dict[str, float]]]
"""Returns the loss of a step and its parts, at a progress in [0, 1), with choices of a generator of the step's own."""


class TrainingLoop:
    """A training of a module that can be resumed from its checkpoint file; `seconds` is how long its steps took."""

    def __init__(
        self, name: str, module: nn.Module, schedule: Schedule, loss: Step, seed: int, path: Path, data: str = ""
    ):
        """Begins, or goes on from the checkpoint at `path` if there is one. data: the digest of the training data.

        Raises InvalidRequest("--out") if that checkpoint is damaged, or of another part, schedule, seed or data.
        """
        self.module, self.schedule, self.step, self.seconds = module, schedule, 0, 0.0
        self._loss, self._seed, self._path = loss, seed, path
        self._about = {"name": name, "schedule": asdict(schedule), "seed": seed, "data": data}
        groups = [
            {"params": [p for p in module.parameters() if p.dim() > 1], "weight_decay": schedule.decay},
            {"params": [p for p in module.parameters() if p.dim() <= 1], "weight_decay": 0.0},
        ]
        self._optimiser = torch.optim.AdamW(groups, lr=schedule.rate, foreach=True)
        if path.exists():
            self._load()

    def run(self, said: Callable[[Report], None], stop: Callable[[int], bool] = lambda _: False) -> None:
        """Takes the steps that are left, with a checkpoint every few minutes and at the end.

        `said` gets a report every few steps. `stop` is asked after each step, with its number, whether to end early; no
        checkpoint is then written.
        """
        began = saved = last = time.monotonic()
        first, losses = self.step, []
        self.module.train()
        while self.step < self.schedule.steps:
            losses.append(self._take())
            self.step += 1
            now = time.monotonic()
            self.seconds, last = self.seconds + now - last, now
            if self.step % REPORT_STEPS == 0:
                means = {name: float(np.mean([row[name] for row in losses])) for name in losses[0]}
                said(Report(self.step, self.schedule.steps, means, (self.step - first) / (now - began)))
                losses = []
            if now - saved > CHECKPOINT_SECONDS:
                self.save()
                saved = now
            if stop(self.step):
                return
        self.save()

    def save(self) -> None:
        """Writes the checkpoint: after a kill the file is the old or the new one, complete."""
        state = {"module": self.module.state_dict(), "optimiser": self._optimiser.state_dict()}
        checkpoints.write(self._path, self._about, state | {"step": self.step, "seconds": self.seconds})

    def _load(self) -> None:
        state = checkpoints.read(self._path, self._about)
        self.module.load_state_dict(state["module"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step, self.seconds = state["step"], state["seconds"]

    def _take(self) -> dict[str, float]:
        """Takes one step; returns the parts of its loss."""
        loss, parts = self._loss(self.step / self.schedule.steps, np.random.default_rng([self._seed, self.step]))
        for group in self._optimiser.param_groups:
            group["lr"] = self.schedule.rate_at(self.step)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.module.parameters(), self.schedule.clip)
        self._optimiser.step()
        return parts
