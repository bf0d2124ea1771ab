"""Loads a network that a user brings: by its card and the files in its folder, by a factory that the operator allows,
or from the caller of the same process, who passes a torch module or a function.

A factory returns a torch module, a MAITE image classifier or a target. MAITE
(https://github.com/mit-ll-ai-technology/maite) is a protocol, not a base class, so it need not be installed: a model
takes a sequence of images [C, H, W], returns scores or probabilities [K] for each, and has `metadata`.
"""

import hashlib
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from scene_attack.errors import InvalidRequest, Unreadable, out_of_memory, summary
from scene_attack.extras import extra
from scene_attack.targets.architectures import ARCHITECTURES, Architecture
from scene_attack.targets.classifier import Classifier
from scene_attack.targets.custom import exported
from scene_attack.targets.custom.card import AllowList, Card, Preprocessing
from scene_attack.targets.custom.endpoint import Endpoint
from scene_attack.targets.info import TargetInfo, Vocabulary
from scene_attack.targets.protocol import QuestionTarget, Target
from scene_attack.targets.weights_file import read_tensors


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
        # In a tuple, so that a model that is a module is no part of this one and stays on the CPU, as its images do.
        self._models = (model,)
        if isinstance(model, nn.Module):
            model.eval()
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
        return torch.stack([torch.as_tensor(scores, dtype=torch.float32) for scores in self._models[0](list(images))])


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
        std=preprocessing.std,
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
    size, probabilities = card.preprocessing.input_size, card.output == "probabilities"
    try:
        if card.endpoint is not None:
            return Endpoint(name, card.endpoint, labels, size, probabilities, card_sha256, allowed)
        if file is not None:
            with file.open("rb") as opened:
                weights_sha256 = hashlib.file_digest(opened, "sha256").hexdigest()
            network, scores_only = _network(file, card, len(labels))
        else:
            assert card.factory is not None
            model = make(card.factory, allowed)
            if not (isinstance(model, nn.Module) or is_maite(model)):
                return _target(model)
            weights_sha256 = digest(model)
            network, scores_only = _module(model, labels, size)
        of = (name, network, labels, card.preprocessing, weights_sha256, dtype)
        return classifier(*of, probabilities=probabilities, scores_only=scores_only)
    except (Unreadable, OSError) as error:
        what = card.factory or card.endpoint if file is None else file.name
        raise InvalidRequest("target.name", f"target {name!r} cannot be loaded: {what}: {error}") from error


def _target(model: Any) -> Target:
    if not (hasattr(model, "logits") and hasattr(model, "labels")):
        kind = type(model).__name__
        raise Unreadable(f"it returned a {kind}, which is no torch module, MAITE image classifier or target")
    target: Target = model
    return target


def _module(model: Any, labels: tuple[str, ...], size: tuple[int, int]) -> tuple[nn.Module, str | None]:
    """The network that a factory returned, and the reason for which it has no gradients."""
    if not is_maite(model):
        return model, None
    check_labels(model, labels)
    network = MaiteNetwork(model, size)
    return network, network.scores_only


def _network(file: Path, card: Card, classes: int) -> tuple[nn.Module, str | None]:
    """The network of a model file, and the reason for which it has no gradients."""
    size = card.preprocessing.input_size
    if file.suffix == ".pt2":
        return exported.read(file, size), None
    if file.suffix == ".safetensors":
        assert card.architecture is not None
        return _read_weights(file, card.architecture, ARCHITECTURES[card.architecture], classes), None
    with extra("onnx", "a network in an .onnx file", "target.name"):
        from scene_attack.targets.custom import onnx_file
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


def target_of(
    name: str, network: Any, labels: tuple[str, ...], preprocessing: Preprocessing, *, probabilities: bool = False
) -> Classifier:
    """Returns a copy of the module as a target; the copy is in evaluation mode and frozen. A MAITE model that is no
    module is not copied. Raises Unreadable if its labels are not these.
    """
    copied = deepcopy(network) if isinstance(network, nn.Module) else network
    module, scores_only = _module(copied, labels, preprocessing.input_size)
    of = (name, module, labels, preprocessing, digest(network))
    return classifier(*of, probabilities=probabilities, scores_only=scores_only)


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
    name: str,
    function: Callable[[Tensor], Any],
    labels: tuple[str, ...],
    preprocessing: Preprocessing,
    *,
    probabilities: bool = False,
) -> Classifier:
    """Returns a function as a target without gradients. Its hash is of its name, as its computation is unknown."""
    where = f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', type(function).__qualname__)}"
    digest_of_name = hashlib.sha256(where.encode()).hexdigest()
    why = "it is a function, of which scores alone are taken; pass a torch.nn.Module for gradients"
    of = (name, ScoresOnly(function), labels, preprocessing, digest_of_name)
    return classifier(*of, probabilities=probabilities, scores_only=why)


def endpoint_of(url: str, name: str, card: Card, labels: tuple[str, ...], allowed: AllowList) -> Target:
    """Returns the network behind a URL that the caller names, which needs no other permission, as a target."""
    digest_of_card = hashlib.sha256(card.model_dump_json().encode()).hexdigest()
    return load(
        name, None, card, labels, digest_of_card, replace(allowed, endpoints=allowed.endpoints | {url}), torch.float32
    )


def describe(name: str, target: Target, vocabulary: Vocabulary = "custom") -> TargetInfo:
    """Returns the card of a target that has no other. `vocabulary` is the meaning of its labels, as on a card.

    Its hash is that of all but the weights: labels, and of a `Classifier` the preprocessing.
    """
    about = [getattr(target, part, None) for part in ("labels", "input_size", "mean", "std", "resize")]
    return TargetInfo(
        name=name,
        title=name,
        task="questions" if isinstance(target, QuestionTarget) else "classification",
        input_size=target.input_size,
        classes=len(target.labels),
        differentiable=target.differentiable,
        source="passed in the process",
        licence="not stated",
        vocabulary=vocabulary,
        card_sha256=hashlib.sha256(repr(about).encode()).hexdigest(),
    )
