"""The training of AlexNet and ResNet-34: recipes, the steps, AlexNet as it is trained, and the data: views of the
training models, looks, and hints of a teacher. Convolutions and products are computed in bfloat16, weights and their
updates in float32.

AlexNet has batch normalisation after each layer, and hidden matrices of low rank: without normalisation it learns
slowly, and its hidden matrices hold 54 of its 57 million weights. After training the normalisation is folded into the
layers and each pair of factors multiplied out, which gives AlexNet itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from math import cos, pi
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.description import ELEVATION, Environment
from scene_attack.scenes.furniture import PREFIX
from scene_attack.scenes.library import Library
from scene_attack.targets.networks import CHANNELS, GRID, HIDDEN, ResNet
from training.batches import as_in_default_scene, augmented, distort, normalised, plain, shade
from training.looks import default_looks, environment_look, environment_looks, looks
from training.loop import Report, Said, TrainingLoop, read
from training.teacher import features_of
from training.teacher import load as load_teacher
from training.views import INPUT, Views, joined, training_cameras, views

DEFAULT_SCENES = 0.8
"""Share of the batches that show the default scene in the last part of a training."""
CALM = 1 / 3
"""Strength of the distortions of those batches."""


@dataclass(frozen=True)
class Recipe:
    """Settings of a training.

    rate: the peak learning rate of AdamW. hints: weight of the loss on the teacher's features, which falls to 0 at
    half of the training. default_from: the progress from which most batches show the default scene of one of the
    renderers, which is what the network is judged on. one_look: all of them show it undistorted, by the torch renderer
    in plastic, as networks are trained that know one light and one material; the paper's are.
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
    one_look: bool = False

    @property
    def name(self) -> str:
        """Its network, and how it is trained if that is not as those that ship."""
        return f"{self.network}-one-look" if self.one_look else self.network

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


def one_look(recipe: Recipe) -> Recipe:
    """The recipe for networks that know one light and one material."""
    return replace(recipe, one_look=True, views=8, looks=0, smoothing=0.0)


@dataclass(frozen=True)
class Budget:
    """Length of a training: exactly one of a number of minutes and a number of epochs is not None.

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


@dataclass(frozen=True)
class Data:
    """Training data of a network.

    views: the views. labels: int64 [V], the class of each. looks: [T, GRID², 6]. default_looks: the same of the
    default scene. hints: float32 [V, F], the teacher's features of each view, or None.
    """

    views: Views
    labels: Tensor
    looks: Tensor
    default_looks: Tensor
    hints: Tensor | None = None


class Training:
    """A training that can be resumed from its checkpoint file."""

    def __init__(self, recipe: Recipe, classes: int, data: Data, seed: int, path: Path) -> None:
        """Makes the network, or loads the checkpoint at `path` if there is one.

        Raises InvalidRequest("--out") if that checkpoint is of another recipe, seed or set of views.
        """
        self.recipe, self.data, self.seed = recipe, data, seed
        torch.manual_seed(seed)
        self.network = network(recipe, classes)
        self.head = None if data.hints is None else nn.Linear(512, data.hints.shape[1])
        learned = nn.ModuleList([self.network, *([] if self.head is None else [self.head])])
        learned.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        about = {"recipe": asdict(recipe), "seed": seed, "views": len(data.labels)}
        self.loop = TrainingLoop(learned, path, about, (seed, 2), recipe.weight_decay, recipe.clip)

    @property
    def steps_per_epoch(self) -> int:
        """Batches of an epoch; the last views of its order make no whole batch and are left out."""
        return len(self.data.labels) // self.recipe.batch

    def run(
        self, budget: Budget, said: Callable[[Report], None], stop: Callable[[int], bool] = lambda _: False
    ) -> None:
        """Trains until the budget is used up; `said` and `stop` as for the loop, with the losses "loss" and "right"."""
        self.loop.notes = {"budget": asdict(budget)}

        def progress_at(step: int, seconds: float) -> float:
            return budget.progress(step, self.steps_per_epoch, seconds)

        self.loop.run(progress_at, lambda _, progress: self.recipe.rate_at(progress), self._loss, said, stop)

    def _loss(self, progress: float, random: np.random.Generator) -> tuple[Tensor, dict[str, float]]:
        """The loss of one step with the hints; without them, and the share of right answers."""
        recipe = self.recipe
        torch.manual_seed(int(random.integers(2**31)))  # dropout
        chosen = self._chosen()
        labels = self.data.labels[torch.from_numpy(chosen)]
        images = normalised(self.images(chosen, progress, random))
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
        right = float((logits.argmax(1) == labels).double().mean())
        return total, {"loss": float(loss.detach()), "right": right}

    def images(self, chosen: NDArray[np.int64], progress: float, random: np.random.Generator) -> Tensor:
        """Returns images [B, 3, h, w] in [0,1] of the chosen views."""
        views = self.data.views
        if self.recipe.one_look:
            looks = self.data.default_looks
            return shade(views, looks, as_in_default_scene(views, chosen, len(looks), random))
        if progress >= self.recipe.default_from and random.random() < DEFAULT_SCENES:
            looks = self.data.default_looks
            return distort(shade(views, looks, as_in_default_scene(views, chosen, len(looks), random)), random, CALM)
        looks = self.data.looks
        return distort(shade(views, looks, augmented(views, chosen, len(looks), random)), random)

    def _chosen(self) -> NDArray[np.int64]:
        """Returns the views of the step's batch: its part of the epoch's random order."""
        epoch, place = divmod(self.loop.step, self.steps_per_epoch)
        if self._order is None or self._order[0] != epoch:
            order = np.random.default_rng([self.seed, 3, epoch]).permutation(len(self.data.labels))
            self._order = (epoch, order)
        return self._order[1][place * self.recipe.batch :][: self.recipe.batch]

    _order: tuple[int, NDArray[np.int64]] | None = None


def network(recipe: Recipe, classes: int) -> nn.Module:
    """Returns the network of a recipe in the form in which it is trained, with random weights."""
    if recipe.network == "alexnet":
        return TrainableAlexNet(classes, recipe.dropout)
    model = ResNet(classes)
    for module in model.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
    return model


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
    state = read(path)
    model = network(recipe, classes)
    learned = {name[2:]: value for name, value in state["module"].items() if name.startswith("0.")}
    model.load_state_dict(learned)
    about = state["about"]
    return Trained(
        model.eval(), Budget(**state["notes"]["budget"]), about["seed"], state["step"], state["seconds"], about["views"]
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


RANK = 256
"""Rank of the hidden matrices."""
CONVOLUTIONS = ((0, 3, 64, 11, 4, 2), (3, 64, 192, 5, 1, 2), (6, 192, 384, 3, 1, 1), (8, 384, CHANNELS, 3, 1, 1))
LAST = (10, CHANNELS, CHANNELS, 3, 1, 1)
"""Number in torchvision's sequence, input and output channels, kernel, stride and padding of each convolution."""
POOLED = (0, 3, 10)
"""Convolutions that max pooling follows."""
HIDDEN_LAYERS = (1, 4)
OUTPUT_LAYER = 6
"""Numbers of the linear layers in torchvision's sequence."""


class Hidden(nn.Module):
    """A hidden layer: dropout, a matrix as the product of two, normalisation, ReLU."""

    def __init__(self, inputs: int, dropout: float, rank: int):
        super().__init__()
        self.dropout = nn.Dropout(dropout)
        self.right = nn.Linear(inputs, rank, bias=False)
        self.left = nn.Linear(rank, HIDDEN, bias=False)
        self.norm = nn.BatchNorm1d(HIDDEN)

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, inputs] to [B, HIDDEN]."""
        y: Tensor = self.norm(self.left(self.right(self.dropout(x))))
        return y.relu_()


class TrainableAlexNet(nn.Module):
    """Normalised images [B, 3, h, w] to logits [B, classes]; `folded` gives the weights of AlexNet."""

    def __init__(self, classes: int, dropout: float, rank: int = RANK):
        super().__init__()
        layers: list[nn.Module] = []
        for number, inputs, outputs, kernel, stride, padding in (*CONVOLUTIONS, LAST):
            convolution = nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=False)
            nn.init.kaiming_normal_(convolution.weight, mode="fan_out", nonlinearity="relu")
            layers += [convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)]
            if number in POOLED:
                layers.append(nn.MaxPool2d(3, 2))
        self.features = nn.Sequential(*layers)
        self.avgpool = nn.AdaptiveAvgPool2d(GRID)
        self.hidden = nn.Sequential(Hidden(CHANNELS * GRID[0] * GRID[1], dropout, rank), Hidden(HIDDEN, dropout, rank))
        self.output = nn.Linear(HIDDEN, classes)

    def forward(self, x: Tensor) -> Tensor:
        """Maps normalised images [B, 3, h, w] to logits [B, classes]."""
        logits: Tensor = self.output(self.hidden(self.avgpool(self.features(x)).flatten(1)))
        return logits

    @torch.no_grad()
    def folded(self) -> dict[str, Tensor]:
        """Returns AlexNet's weights under torchvision's names, float32.

        A hidden matrix is a pair of factors: `<name>.left` [HIDDEN, rank] times `<name>.right` [rank, inputs].
        """
        state = {}
        convolutions = [layer for layer in self.features if isinstance(layer, nn.Conv2d)]
        norms = [layer for layer in self.features if isinstance(layer, nn.BatchNorm2d)]
        for (number, *_), convolution, norm in zip((*CONVOLUTIONS, LAST), convolutions, norms, strict=True):
            scale, shift = _affine(norm)
            state[f"features.{number}.weight"] = convolution.weight.double() * scale[:, None, None, None]
            state[f"features.{number}.bias"] = shift
        for number, hidden in zip(HIDDEN_LAYERS, self.hidden, strict=True):
            assert isinstance(hidden, Hidden)
            scale, shift = _affine(hidden.norm)
            state[f"classifier.{number}.weight.left"] = hidden.left.weight.double() * scale[:, None]
            state[f"classifier.{number}.weight.right"] = hidden.right.weight
            state[f"classifier.{number}.bias"] = shift
        state[f"classifier.{OUTPUT_LAYER}.weight"] = self.output.weight
        state[f"classifier.{OUTPUT_LAYER}.bias"] = self.output.bias
        return {name: value.detach().float().contiguous() for name, value in state.items()}


def _affine(norm: nn.BatchNorm1d | nn.BatchNorm2d) -> tuple[Tensor, Tensor]:
    """Returns the scale and the shift of a normalisation in evaluation, float64."""
    assert norm.running_var is not None
    assert norm.running_mean is not None
    scale = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
    return scale, norm.bias.double() - norm.running_mean.double() * scale


HINTS = 256
"""Principal components of the teacher's features that are kept as hints."""
TEACHER_SIZE = (160, 160)
"""Size of the images that the teacher sees: smaller than its own, and twice as fast."""
TURNS = 24
"""Sides from which the default scene's light comes."""
AT_ONCE = 32
"""Views that the teacher looks at together."""


def gather(
    library: Library,
    cache: Path,
    recipe: Recipe,
    models: Sequence[tuple[int, str]],
    seed: int,
    said: Said,
) -> Data:
    """Returns the data of a recipe: `models` are (class, slug). Drawn views and hints are kept in `cache`.

    `said` gets a step's name, the amount done, and the total.
    """
    parts = []
    for _, slug in models:
        cameras = training_cameras(PREFIX + slug, recipe.views, seed, INPUT)
        parts.append(views(library, PREFIX + slug, cameras, cache / "training" / "views"))
        said("drawing models", len(parts), len(models), "")
    drawn = joined(parts)
    labels = torch.tensor([number for number, _ in models]).repeat_interleave(recipe.views)
    said("tabulating looks", 0, 1, "")
    if recipe.one_look:
        default = environment_looks(library, TURNS, "plastic")
        tables = default[:0]
    else:
        tables, default = looks(library, recipe.looks, seed), default_looks(library, TURNS)
    hints = None if recipe.hints == 0 else _hints(library, drawn, said)
    return Data(drawn, labels, tables, default, hints)


def _hints(library: Library, drawn: Views, said: Said) -> Tensor:
    """Returns the teacher's features of each view in the default light, as principal components of unit variance."""
    teacher = load_teacher()
    table = environment_look(library, Environment(), "matte", ELEVATION)[None]
    count = drawn.count
    batches = []
    for start in range(0, count, AT_ONCE):
        at = np.arange(start, min(start + AT_ONCE, count))
        images = shade(drawn, table, plain(at, np.zeros_like(at)))
        batches.append(features_of(teacher, F.interpolate(images, TEACHER_SIZE, mode="bilinear")))
        said("asking the teacher", start + len(at), count, "")
    features = torch.cat(batches)
    centred = features - features.mean(0)
    values, vectors = torch.linalg.eigh((centred.T @ centred / len(centred)).double())
    kept = slice(max(0, len(values) - HINTS), None)
    scaled: Tensor = centred.double() @ vectors[:, kept] / values[kept].clamp_min(1e-12).sqrt()
    return scaled.float()
