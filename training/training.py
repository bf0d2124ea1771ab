"""The training loop: batches, steps, checkpoints.

What a step does follows from the seed, the step's number and the state before it alone, so a training of a number of
epochs that is killed and resumed ends in the same bits. Convolutions and products are computed in bfloat16, weights and
their updates in float32.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from services.errors import InvalidRequest
from services.targets.networks.resnet import ResNet
from training import checkpoints
from training.batches import as_in_default_scene, augmented, normalised, shade
from training.distortions import distort
from training.recipe import CALM, DEFAULT_SCENES, Budget, Recipe
from training.trainable_alexnet import TrainableAlexNet
from training.views import Views

CHECKPOINT_SECONDS = 120.0
"""Time between checkpoints."""
REPORT_STEPS = 20
"""Steps between reports; loss and accuracy are means over them."""


@dataclass(frozen=True)
class Data:
    """What a network is trained on.

    views: the views. labels: int64 [V], the class of each. looks: [T, GRID², 6]. default_looks: the same of the
    default scene. hints: float32 [V, F], the teacher's features of each view, or None.
    """

    views: Views
    labels: Tensor
    looks: Tensor
    default_looks: Tensor
    hints: Tensor | None = None


@dataclass(frozen=True)
class Report:
    """Where a training is. rate: images per second of this process's run."""

    step: int
    epoch: float
    progress: float
    loss: float
    accuracy: float
    rate: float


class Training:
    """A training that can be resumed from its checkpoint file."""

    def __init__(self, recipe: Recipe, classes: int, data: Data, seed: int, path: Path) -> None:
        """Makes the network, or loads the checkpoint at `path` if there is one.

        Raises InvalidRequest("--out") if that checkpoint is of another recipe, seed or set of views.
        """
        self.recipe, self.data, self.seed, self._path = recipe, data, seed, path
        torch.manual_seed(seed)
        self.network = network(recipe, classes)
        self.head = None if data.hints is None else nn.Linear(512, data.hints.shape[1])
        self._learned = nn.ModuleList([self.network, *([] if self.head is None else [self.head])])
        self._learned.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        decayed = [p for p in self._learned.parameters() if p.dim() > 1]
        others = [p for p in self._learned.parameters() if p.dim() <= 1]
        groups = [
            {"params": decayed, "weight_decay": recipe.weight_decay},
            {"params": others, "weight_decay": 0.0},
        ]
        self._optimiser = torch.optim.AdamW(groups, lr=recipe.rate, foreach=True)
        self.step, self.seconds, self._budget = 0, 0.0, Budget()
        if path.exists():
            self._load()

    @property
    def steps_per_epoch(self) -> int:
        """Batches of an epoch; the last views of its order make no whole batch and are left out."""
        return len(self.data.labels) // self.recipe.batch

    def run(
        self, budget: Budget, said: Callable[[Report], None], stop: Callable[[int], bool] = lambda _: False
    ) -> None:
        """Trains until the budget is used up, with a checkpoint every few minutes and at the end.

        `said` gets a report every few steps. `stop` is asked after each step, with its number, whether to end early.
        """
        self._budget = budget
        began, first = time.monotonic() - self.seconds, self.step
        started, saved = time.monotonic(), time.monotonic()
        losses, rights = [], []
        self._learned.train()
        while (progress := budget.progress(self.step, self.steps_per_epoch, self.seconds)) < 1:
            loss, right = self._step(progress)
            losses.append(loss)
            rights.append(right)
            self.step += 1
            now = time.monotonic()
            self.seconds = now - began
            if self.step % REPORT_STEPS == 0:
                rate = (self.step - first) * self.recipe.batch / (now - started)
                epoch = self.step / self.steps_per_epoch
                said(Report(self.step, epoch, progress, float(np.mean(losses)), float(np.mean(rights)), rate))
                losses, rights = [], []
            if now - saved > CHECKPOINT_SECONDS:
                self.save()
                saved = now
            if stop(self.step):
                return
        self.save()

    def save(self) -> None:
        """Writes the checkpoint: after a kill the file is the old or the new one, complete."""
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "budget": asdict(self._budget),
            "learned": self._learned.state_dict(),
            "optimiser": self._optimiser.state_dict(),
        }
        checkpoints.write(self._path, self._about, state)

    @cached_property
    def _about(self) -> dict[str, Any]:
        """What a checkpoint must agree with."""
        return {"recipe": asdict(self.recipe), "seed": self.seed, "views": len(self.data.labels)}

    def _load(self) -> None:
        state = checkpoints.read(self._path, self._about)
        self._learned.load_state_dict(state["learned"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step, self.seconds = state["step"], state["seconds"]

    def _step(self, progress: float) -> tuple[float, float]:
        """Takes one step; returns its loss and the share of right answers."""
        recipe = self.recipe
        random = np.random.default_rng([self.seed, 2, self.step])
        torch.manual_seed(int(random.integers(2**31)))  # dropout
        chosen = self._chosen()
        labels = self.data.labels[torch.from_numpy(chosen)]
        images = normalised(self._images(chosen, progress, random))
        for group in self._optimiser.param_groups:
            group["lr"] = recipe.rate_at(progress)
        self._optimiser.zero_grad()
        weight = recipe.hints_at(progress)
        with torch.autocast("cpu", dtype=torch.bfloat16):
            if self.head is not None and isinstance(self.network, ResNet):
                pooled = self.network.pooled(images)
                logits, hinted = self.network.fc(pooled), self.head(pooled)
            else:
                logits, hinted = self.network(images), None
        loss = F.cross_entropy(logits.float(), labels, label_smoothing=recipe.smoothing)
        total = loss
        if hinted is not None and weight > 0:
            assert self.data.hints is not None
            total = loss + weight * F.mse_loss(hinted.float(), self.data.hints[torch.from_numpy(chosen)])
        total.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self._learned.parameters(), recipe.clip)
        self._optimiser.step()
        return float(loss.detach()), float((logits.argmax(1) == labels).double().mean())

    def _images(self, chosen: NDArray[np.int64], progress: float, random: np.random.Generator) -> Tensor:
        """Returns images [B, 3, h, w] in [0,1] of the chosen views."""
        views = self.data.views
        if progress >= self.recipe.default_from and random.random() < DEFAULT_SCENES:
            looks = self.data.default_looks
            return distort(shade(views, looks, as_in_default_scene(views, chosen, len(looks), random)), random, CALM)
        looks = self.data.looks
        return distort(shade(views, looks, augmented(views, chosen, len(looks), random)), random)

    def _chosen(self) -> NDArray[np.int64]:
        """Returns the views of the step's batch: its part of the epoch's random order."""
        epoch, place = divmod(self.step, self.steps_per_epoch)
        if self._order is None or self._order[0] != epoch:
            order = np.random.default_rng([self.seed, 3, epoch]).permutation(len(self.data.labels))
            self._order = (epoch, order)
        return self._order[1][place * self.recipe.batch :][: self.recipe.batch]

    _order: tuple[int, NDArray[np.int64]] | None = None


def network(recipe: Recipe, classes: int) -> nn.Module:
    """Returns the network of a recipe in the form in which it is trained, with random weights."""
    if recipe.network == "alexnet":
        return TrainableAlexNet(classes, recipe.dropout)
    made = ResNet(classes)
    for module in made.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
    return made


@dataclass(frozen=True)
class Trained:
    """A network from a checkpoint, in evaluation, and how it was trained."""

    network: nn.Module
    budget: Budget
    seed: int
    steps: int
    seconds: float
    views: int


def load_trained(recipe: Recipe, classes: int, path: Path) -> Trained:
    """Returns the network of a checkpoint. Raises InvalidRequest("--out") if there is none."""
    if not path.exists():
        raise InvalidRequest("--out", f"there is no checkpoint {path}")
    state = torch.load(path, weights_only=True)
    made = network(recipe, classes)
    learned = {name[2:]: value for name, value in state["learned"].items() if name.startswith("0.")}
    made.load_state_dict(learned)
    about = state["about"]
    return Trained(
        made.eval(), Budget(**state["budget"]), about["seed"], state["step"], state["seconds"], about["views"]
    )


def weights(trained: nn.Module) -> dict[str, Tensor]:
    """Returns a trained network's weights under torchvision's names, AlexNet's hidden matrices as pairs of factors."""
    if isinstance(trained, TrainableAlexNet):
        return trained.folded()
    return {
        name: value.detach().float().contiguous()
        for name, value in trained.state_dict().items()
        if not name.endswith("num_batches_tracked")
    }
