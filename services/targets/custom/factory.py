"""Calls a factory that the operator allows: it returns a torch module, a MAITE image classifier or a target.

MAITE (https://github.com/mit-ll-ai-technology/maite) is a protocol, not a base class, so it need not be installed: a
model takes a sequence of images [C, H, W], returns scores or probabilities [K] for each, and has `metadata`.
"""

import hashlib
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import torch
from torch import Tensor, nn

from services.errors import out_of_memory, summary
from services.targets.custom.card import AllowList
from services.targets.custom.graph import Unreadable


def make(factory: str, allowed: AllowList) -> Any:
    """Returns what the factory returns. Raises Unreadable if it is not allowed, does not exist or fails."""
    reason = allowed.factory_refusal(factory)
    if reason is not None:
        raise Unreadable(reason)
    module, _, function = factory.partition(":")
    try:
        return getattr(import_module(module), function)()
    except (Exception, SystemExit) as error:
        if out_of_memory(error):
            raise
        raise Unreadable(f"the factory {factory} fails: {summary(error)}") from error


class MaiteNetwork(nn.Module):
    """A MAITE image classifier as a torch module: inputs [B, C, H, W] to [B, K].

    The model gets a list of float32 CPU tensors [C, H, W], which are arrays to numpy too, and may return any arrays.
    """

    def __init__(self, model: Callable[[Sequence[Tensor]], Sequence[Any]], size: tuple[int, int]) -> None:
        super().__init__()
        self._model = model
        self.scores_only = self._trouble(size)
        """The reason for which scores have no gradients; None if they have."""

    def _trouble(self, size: tuple[int, int]) -> str | None:
        image = torch.full((1, 3, *size), 0.5, requires_grad=True)
        try:
            with torch.enable_grad():
                scores = self._answers(image)
        except Exception as error:  # numpy refuses tensors that need gradients, among others
            return f"it fails on images that need gradients: {summary(error)}"
        return None if scores.requires_grad else "what it returns is not computed by torch from the images"

    def forward(self, x: Tensor) -> Tensor:
        """Maps inputs [B, C, H, W] to [B, K]."""
        images = x.to("cpu", torch.float32)
        return self._answers(images if self.scores_only is None else images.detach()).to(x.device)

    def _answers(self, images: Tensor) -> Tensor:
        return torch.stack([torch.as_tensor(scores, dtype=torch.float32) for scores in self._model(list(images))])


def is_maite(model: object) -> bool:
    """Whether an object is a MAITE model: it can be called, and has metadata with an id."""
    metadata = getattr(model, "metadata", None)
    return callable(model) and isinstance(metadata, dict) and "id" in metadata


def check_labels(model: Any, labels: Sequence[str]) -> None:
    """Raises Unreadable if a MAITE model's own labels (`index2label`) are not those of the card."""
    own = model.metadata.get("index2label")
    if own is not None and [own.get(index) for index in range(len(own))] != list(labels):
        raise Unreadable(f"its metadata.index2label has {len(own)} labels, which are not the {len(labels)} of the card")


def digest(model: Any) -> str:
    """Returns the SHA-256 (hex) of a module's weights, or of the modules among an object's attributes and its id."""
    total = hashlib.sha256(str(getattr(model, "metadata", "")).encode())
    parts = [model] if isinstance(model, nn.Module) else [value for _, value in sorted(vars(model).items())]
    for part in parts:
        if isinstance(part, nn.Module):
            for name, value in part.state_dict().items():
                total.update(f"{name} {value.dtype} {list(value.shape)}".encode())
                total.update(value.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return total.hexdigest()
