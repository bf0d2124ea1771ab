"""Wraps an image classifier as a target: it resizes and normalises images and runs the network."""

import json
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from scene_attack.errors import InvalidRequest, summary
from scene_attack.plugins import NAME
from scene_attack.process import describe, device
from scene_attack.targets.labels import imagenet_labels


@dataclass
class Classifier:
    """A frozen image classifier on the configured device, differentiable if its network is; implements `Target`.

    `mean` and `std` define its input normalisation, (pixel − mean) / std with pixels in [0,1].
    """

    name: str
    network: nn.Module
    labels: tuple[str, ...]
    input_size: tuple[int, int]
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    weights_sha256: str
    dtype: torch.dtype = torch.float32
    resize: Literal["bilinear", "bicubic"] = "bilinear"
    scores_only: str | None = None
    """The reason for which the network has no gradients; None if it has."""
    differentiable: bool = field(default=True, init=False)

    def __post_init__(self) -> None:
        self.differentiable = self.scores_only is None
        self._device = device()
        self.network = self.network.to(self._device, self.dtype).eval().requires_grad_(False)
        # channels_last is 1.4 to 1.7 times faster on a CPU for depthwise networks. `nn.Module.to` lays weights out so
        # too, but fails where some have five dimensions.
        for value in [*self.network.parameters(), *self.network.buffers()]:
            if value.dim() == 4:
                value.data = value.data.contiguous(memory_format=torch.channels_last)
        self._mean = torch.tensor(self.mean, dtype=self.dtype, device=self._device)
        self._std = torch.tensor(self.std, dtype=self.dtype, device=self._device)

    @property
    def backend(self) -> str:
        """A line that names everything that decides the bits of its scores: version, device, dtype, threads."""
        kind = str(self.dtype).removeprefix("torch.")
        where = describe(self._device)
        return f"torch {torch.__version__} {where} {kind} {torch.get_num_threads()} threads"

    def logits(self, images: Tensor) -> Tensor:
        """Returns scores [B, K] of images [B, H, W, 3] in [0,1]; see `Target.logits`."""
        width = images.shape[2]
        # Normalised row by row: broadcasting over the three channels takes six times as long.
        mean, std = self._mean.repeat(width), self._std.repeat(width)
        x = (images.to(self._device, self.dtype).flatten(2) - mean).div_(std)
        x = x.reshape(images.shape).permute(0, 3, 1, 2)
        if tuple(x.shape[-2:]) != self.input_size:
            x = F.interpolate(x, self.input_size, mode=self.resize, antialias=True)
            if self.resize == "bicubic":  # it overshoots at edges
                low, high = (((bound - self._mean) / self._std)[:, None, None] for bound in (0.0, 1.0))
                x = x.clamp(low, high)
        scores = self.network(x.contiguous(memory_format=torch.channels_last))
        if not isinstance(scores, torch.Tensor):
            raise TypeError(f"it returns {type(scores).__name__}, not a tensor of scores [B, K]; wrap it")
        return scores.to(images.device, torch.promote_types(self.dtype, torch.float32))

    def save(self, folder: Path | str) -> None:
        """Writes `card.json` and the network, as `model.pt2`, into a folder, whose name is then the network's where
        SCENE_ATTACK_TARGETS names the folder that it is in.

        Raises InvalidRequest("folder") for a name that no network may have and a folder with something in it, and
        InvalidRequest("target") for a network that torch.export cannot write, as a function of the process.
        """
        place = Path(folder)
        if not NAME.fullmatch(place.resolve().name):
            raise InvalidRequest("folder", f"{place.name!r} is to be the network's name: use a-z, 0-9, - and _")
        if place.exists() and (not place.is_dir() or any(place.iterdir())):
            raise InvalidRequest("folder", f"{place} has something in it already; name a new folder")
        if self.scores_only is not None:
            raise InvalidRequest("target", f"it cannot be saved, only a torch module can: {self.scores_only}")
        network = deepcopy(self.network).cpu()
        for value in [*network.parameters(), *network.buffers()]:
            value.data = value.data.contiguous()
        images = torch.zeros(2, 3, *self.input_size, dtype=self.dtype)
        try:
            shapes = ({0: torch.export.Dim("batch")},)
            program = torch.export.export(network, (images,), dynamic_shapes=shapes)
        except Exception as error:  # of whatever kind, with a page about the module's own code
            raise InvalidRequest("target", f"torch.export cannot write it: {summary(error)}") from error
        preprocessing = {"input_size": self.input_size, "mean": self.mean, "std": self.std, "resize": self.resize}
        labels = "imagenet" if self.labels == imagenet_labels() else self.labels
        place.mkdir(parents=True, exist_ok=True)
        torch.export.save(program, place / "model.pt2")
        (place / "card.json").write_text(
            json.dumps({"labels": labels, "preprocessing": preprocessing}, indent=1), "utf-8"
        )
