"""Makes a target of a torch module, or of a function, that a caller of the same process passes."""

import hashlib
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn

from services.targets.classifier import Classifier
from services.targets.custom.card import Preprocessing
from services.targets.custom.factory import digest
from services.targets.custom.loading import classifier
from services.targets.info import TargetInfo, Vocabulary
from services.targets.protocol import Target


def target_of(name: str, network: nn.Module, labels: tuple[str, ...], preprocessing: Preprocessing) -> Classifier:
    """Returns a copy of the module as a target; the copy is in evaluation mode and frozen."""
    return classifier(name, deepcopy(network), labels, preprocessing, digest(network))


class ScoresOnly(nn.Module):
    """A function of images as a module without weights. It is called with float32 CPU tensors that need no gradient."""

    def __init__(self, function: Callable[[Tensor], Any]) -> None:
        super().__init__()
        self.function = function

    @torch.no_grad()
    def forward(self, x: Tensor) -> Tensor:
        """Maps inputs [B, 3, h, w] to scores [B, K], which the function may return as any array."""
        return torch.as_tensor(self.function(x.to("cpu", torch.float32, memory_format=torch.contiguous_format))).to(x)


def scores_of(
    name: str, function: Callable[[Tensor], Any], labels: tuple[str, ...], preprocessing: Preprocessing
) -> Classifier:
    """Returns a function as a target without gradients. Its hash is that of its name: what it computes is not known."""
    where = f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', type(function).__qualname__)}"
    digest_of_name = hashlib.sha256(where.encode()).hexdigest()
    why = "it is a function, of which scores alone are taken; pass a torch.nn.Module for gradients"
    return classifier(name, ScoresOnly(function), labels, preprocessing, digest_of_name, scores_only=why)


def describe(name: str, target: Target, vocabulary: Vocabulary = "custom") -> TargetInfo:
    """Returns the card of a target that has no other. `vocabulary` says what its labels are, as a card does.

    Its hash is that of all but the weights: labels, and of a `Classifier` the preprocessing.
    """
    about = [getattr(target, part, None) for part in ("labels", "input_size", "mean", "scale", "resize")]
    return TargetInfo(
        name=name,
        title=name,
        task="question answering" if target.takes_question else "classification",
        input_size=target.input_size,
        classes=len(target.labels),
        differentiable=target.differentiable,
        takes_question=target.takes_question,
        source="passed in the process",
        licence="not stated",
        vocabulary=vocabulary,
        card_sha256=hashlib.sha256(repr(about).encode()).hexdigest(),
    )
