"""A small network for 32×32 images, and the folder of it in each format that a user may bring."""

import json
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import torch
from safetensors.torch import save_file
from torch import Tensor, nn

SIZE = (32, 32)
LABELS = ["red", "green", "blue", "grey", "none"]
MEAN, STD = [0.45, 0.5, 0.4], [0.25, 0.2, 0.3]
CARD: dict[str, Any] = {
    "labels": LABELS,
    "preprocessing": {"input_size": list(SIZE), "mean": MEAN, "std": STD},
    "licence": "CC0-1.0",
    "source": "a test",
}


class SmallNetwork(nn.Module):
    """Convolutions with strides and groups, batch normalisation, pools, a sum of two branches, a linear layer."""

    def __init__(self, classes: int = len(LABELS)) -> None:
        super().__init__()
        self.stem = nn.Sequential(nn.Conv2d(3, 8, 3, stride=2, padding=1), nn.BatchNorm2d(8), nn.ReLU6())
        self.branch = nn.Conv2d(8, 8, 3, padding=1, groups=4)
        self.pool = nn.MaxPool2d(3, stride=2, padding=1)
        self.head = nn.Linear(8 * 16, classes)

    def forward(self, x: Tensor) -> Tensor:
        x = self.stem(x)
        x = self.pool(x + torch.sigmoid(self.branch(x)))
        x = nn.functional.adaptive_avg_pool2d(x, 4)
        found: Tensor = self.head(torch.flatten(x, 1))
        return found


def network() -> SmallNetwork:
    """The network with fixed random weights, in evaluation mode."""
    random = torch.Generator().manual_seed(3)
    made = SmallNetwork().eval().requires_grad_(False)
    for name, value in made.state_dict().items():
        if value.is_floating_point():
            drawn = torch.randn(value.shape, generator=random) * 0.3
            value.copy_(drawn.abs() + 0.5 if name.endswith("running_var") else drawn)
    return made


def folder(root: Path, name: str, **changes: Any) -> Path:
    """A folder with the network's card; `changes` are fields of the card, None to leave one out."""
    made = root / name
    made.mkdir(parents=True)
    card = {key: value for key, value in (CARD | changes).items() if value is not None}
    (made / "card.json").write_text(json.dumps(card))
    return made


def save_pt2(path: Path, module: nn.Module | None = None, fixed: int | None = None) -> None:
    """Exports a network for any number of images, or for `fixed` of them."""
    images = torch.zeros(fixed or 2, 3, *SIZE)
    shapes = None if fixed else ({0: torch.export.Dim("batch")},)
    torch.export.save(torch.export.export(module or network(), (images,), dynamic_shapes=shapes), path)


def save_onnx(path: Path, module: nn.Module | None = None, fixed: int | None = None) -> None:
    """Exports a network for any number of images, or for `fixed` of them."""
    images = torch.zeros(fixed or 2, 3, *SIZE)
    shapes = None if fixed else ({0: torch.export.Dim("batch")},)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own
        torch.onnx.export(
            module or network(), (images,), path, dynamic_shapes=shapes, external_data=False, verbose=False
        )


def save_safetensors(path: Path) -> None:
    save_file(network().state_dict(), path)


class MaiteModel:
    """The network as a MAITE image classifier: a sequence of images [C, H, W] to a list of probabilities."""

    metadata: ClassVar[dict[str, Any]] = {"id": "small", "index2label": dict(enumerate(LABELS))}

    def __init__(self) -> None:
        self.network = network()

    def __call__(self, batch: Sequence[Any]) -> list[Tensor]:
        return list(self.network(torch.stack([torch.as_tensor(one) for one in batch])).softmax(dim=1))


class NumpyModel(MaiteModel):
    """The same, with numpy arrays."""

    def __call__(self, batch: Sequence[Any]) -> list[Any]:
        import numpy as np

        found = super().__call__([np.asarray(one) for one in batch])
        return [one.numpy() for one in found]


def maite() -> MaiteModel:
    return MaiteModel()


def numpy_maite() -> NumpyModel:
    return NumpyModel()


def fails() -> nn.Module:
    raise OSError("weights.bin is not there")


WRITERS: dict[str, Callable[[Path], None]] = {
    "model.pt2": save_pt2,
    "model.onnx": save_onnx,
    "model.safetensors": save_safetensors,
}
