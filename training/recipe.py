"""How each network is trained: batch, learning rate and its schedule, hints."""

from dataclasses import dataclass
from math import cos, pi

DEFAULT_SCENES = 0.8
"""Share of the batches that show the default scene in the last part of a training."""
CALM = 1 / 3
"""Strength of the distortions of those batches."""


@dataclass(frozen=True)
class Recipe:
    """Settings of a training.

    rate: the peak learning rate of AdamW. hints: weight of the loss on the teacher's features, which falls to 0 at
    half of the training. default_from: the progress from which most batches show the default scene of one of the
    renderers, which is what the network is judged on.
    """

    network: str
    batch: int
    rate: float
    dropout: float = 0.0
    hints: float = 0.0
    weight_decay: float = 0.05
    warm_up: float = 0.08
    smoothing: float = 0.05
    clip: float = 5.0
    views: int = 24
    looks: int = 256
    default_from: float = 0.5

    def rate_at(self, progress: float) -> float:
        """Returns the learning rate at a progress in [0, 1]: a linear rise, then half a cosine down to 0."""
        if progress < self.warm_up:
            return self.rate * max(progress / self.warm_up, 1e-3)
        return self.rate * 0.5 * (1 + cos(pi * min(1.0, (progress - self.warm_up) / (1 - self.warm_up))))

    def hints_at(self, progress: float) -> float:
        """Returns the weight of the hints at a progress in [0, 1]."""
        return self.hints * max(0.0, 1 - 2 * progress)


RECIPES = {
    "alexnet": Recipe("alexnet", batch=64, rate=1.5e-3, dropout=0.2),
    "resnet34": Recipe("resnet34", batch=64, rate=1.5e-3, hints=1.0),
}


@dataclass(frozen=True)
class Budget:
    """How long to train: exactly one of a number of minutes and a number of epochs is not None.

    With epochs a training is reproducible bit for bit. With minutes its schedule follows the clock, so that it ends in
    time whatever else the machine does.
    """

    minutes: float | None = None
    epochs: int | None = None

    def progress(self, step: int, steps_per_epoch: int, seconds: float) -> float:
        """Returns the progress in [0, 1] after some steps and some seconds of training."""
        if self.epochs is not None:
            return min(1.0, step / (self.epochs * steps_per_epoch))
        assert self.minutes is not None
        return min(1.0, seconds / (60 * self.minutes))
