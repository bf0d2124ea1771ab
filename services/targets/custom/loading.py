"""Loads a network that a user brings: by its card and the files in its folder, or from the caller of the same process,
who passes a torch module or a function.
"""

import hashlib
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from services.errors import InvalidRequest
from services.targets.architectures import ARCHITECTURES, Architecture
from services.targets.classifier import Classifier
from services.targets.custom import exported, factory
from services.targets.custom.card import AllowList, Card, Preprocessing
from services.targets.custom.endpoint import Endpoint
from services.targets.custom.factory import digest
from services.targets.custom.graph import Unreadable
from services.targets.info import TargetInfo, Vocabulary
from services.targets.protocol import Target
from services.targets.weights_file import read_tensors


class Bgr(nn.Module):
    """Passes the channels in the opposite order."""

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, 3, h, w] to the same with channels reversed."""
        return x.flip(1)


class LogProbabilities(nn.Module):
    """Returns the logarithm of probabilities, which are scores: they differ by a constant from those before softmax."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, x: Tensor) -> Tensor:
        """Maps inputs to scores [B, K]. A probability of 0 counts as the smallest normal float."""
        probabilities: Tensor = self.network(x)
        return probabilities.clamp_min(torch.finfo(torch.float32).tiny).log()


def classifier(
    name: str,
    network: nn.Module,
    labels: tuple[str, ...],
    preprocessing: Preprocessing,
    weights_sha256: str,
    dtype: torch.dtype = torch.float32,
    *,
    probabilities: bool = False,
    scores_only: str | None = None,
) -> Classifier:
    """Returns a torch module as a target. It is changed: frozen, and its weights are laid out channels last."""
    if preprocessing.channels == "bgr":
        network = nn.Sequential(Bgr(), network)
    return Classifier(
        name=name,
        network=LogProbabilities(network) if probabilities else network,
        labels=labels,
        input_size=preprocessing.input_size,
        mean=preprocessing.mean,
        scale=preprocessing.scale,
        weights_sha256=weights_sha256,
        dtype=dtype,
        resize=preprocessing.resize,
        scores_only=scores_only,
    )


def load(
    name: str,
    file: Path | None,
    card: Card,
    labels: tuple[str, ...],
    card_sha256: str,
    allowed: AllowList,
    dtype: torch.dtype,
) -> Target:
    """Returns the target. `file` is the model file; None for a factory or an endpoint.

    Raises InvalidRequest("target.name"), which says why and what is missing, if it cannot be loaded.
    """
    try:
        return _load(name, file, card, labels, card_sha256, allowed, dtype)
    except (Unreadable, OSError) as error:
        what = card.factory or card.endpoint if file is None else file.name
        raise InvalidRequest("target.name", f"target {name!r} cannot be loaded: {what}: {error}") from error


def _load(
    name: str,
    file: Path | None,
    card: Card,
    labels: tuple[str, ...],
    card_sha256: str,
    allowed: AllowList,
    dtype: torch.dtype,
) -> Target:
    size, probabilities = card.preprocessing.input_size, card.output == "probabilities"
    if card.endpoint is not None:
        return Endpoint(name, card.endpoint, labels, size, probabilities, card_sha256, allowed)
    scores_only: str | None = None
    if file is None:
        assert card.factory is not None
        model = factory.make(card.factory, allowed)
        digest = factory.digest(model)
        if factory.is_maite(model):
            factory.check_labels(model, labels)
            maite = factory.MaiteNetwork(model, size)
            network: nn.Module = maite
            scores_only = maite.scores_only
        elif isinstance(model, nn.Module):
            network = model
        elif hasattr(model, "logits") and hasattr(model, "labels"):
            target: Target = model
            return target
        else:
            kind = type(model).__name__
            raise Unreadable(f"it returned a {kind}, which is no torch module, MAITE image classifier or target")
    else:
        with file.open("rb") as opened:
            digest = hashlib.file_digest(opened, "sha256").hexdigest()
        network, scores_only = _network(file, card, len(labels))
    of = (name, network, labels, card.preprocessing, digest, dtype)
    return classifier(*of, probabilities=probabilities, scores_only=scores_only)


def _network(file: Path, card: Card, classes: int) -> tuple[nn.Module, str | None]:
    """The network of a model file, and the reason for which it has no gradients."""
    size = card.preprocessing.input_size
    if file.suffix == ".pt2":
        return exported.read(file, size), None
    if file.suffix == ".safetensors":
        assert card.architecture is not None
        return _read_weights(file, card.architecture, ARCHITECTURES[card.architecture], classes), None
    try:
        from services.targets.custom import onnx_file
    except ImportError as error:
        raise Unreadable(f"it needs the packages of the extra `onnx`: {error}") from error
    return onnx_file.read(file, size), onnx_file.SCORES_ONLY


def _read_weights(path: Path, name: str, known: Architecture, classes: int) -> nn.Module:
    """Returns the network of an architecture with the weights of the file.

    Raises Unreadable if the file is no safetensors file, has a weight that is not finite, or does not fit; names what
    is missing or left over.
    """
    try:
        state, _ = read_tensors(path)
    except ValueError as error:
        raise Unreadable(str(error)) from error
    network = known.build(classes)
    try:
        known.fill(network, state)
    except KeyError as error:
        raise Unreadable(f"it does not fit {name} with {classes} classes: it lacks {error.args[0]}") from error
    except (ValueError, RuntimeError) as error:
        raise Unreadable(f"it does not fit {name} with {classes} classes: {error}") from error
    return network


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
    """Returns a function as a target without gradients. Its hash is of its name, as its computation is unknown."""
    where = f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', type(function).__qualname__)}"
    digest_of_name = hashlib.sha256(where.encode()).hexdigest()
    why = "it is a function, of which scores alone are taken; pass a torch.nn.Module for gradients"
    return classifier(name, ScoresOnly(function), labels, preprocessing, digest_of_name, scores_only=why)


def describe(name: str, target: Target, vocabulary: Vocabulary = "custom") -> TargetInfo:
    """Returns the card of a target that has no other. `vocabulary` is the meaning of its labels, as on a card.

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
