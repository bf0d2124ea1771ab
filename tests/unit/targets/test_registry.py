"""Networks that users bring, each with one mistake: what is said of it, by name, before a job is queued."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from scene_attack.errors import InvalidRequest, JobFailure
from scene_attack.targets import registry
from scene_attack.targets.classifier import Classifier
from scene_attack.targets.info import LONGEST_LABEL, TARGETS, TargetInfo, register
from scene_attack.targets.protocol import Target

LABELS = ("red", "green", "blue")
SIZE = (8, 8)
Labels = Callable[[], Any]


@pytest.fixture(autouse=True)
def _unregistered() -> Iterator[None]:
    """Undoes what a test registers."""
    before = TARGETS.snapshot()
    yield
    TARGETS.restore(before)
    registry.load.cache_clear()
    registry.has_gradient.cache_clear()


def add(labels: Labels, load: Callable[..., Any], **card: Any) -> None:
    """Registers a target "mine" of these labels and this loader."""
    about: dict[str, Any] = {"title": "Mine", "task": "classification", "input_size": SIZE, "classes": 3}
    about |= {"differentiable": True, "source": "a test", "licence": "CC0-1.0"}
    register(TargetInfo.model_validate(about | {"name": "mine"} | card), labels)(load)


class Function(nn.Module):
    """A network that is a function of its normalised input [B, 3, 8, 8]."""

    def __init__(self, function: Callable[[Tensor], Any]) -> None:
        super().__init__()
        self.function = function

    def forward(self, x: Tensor) -> Any:
        return self.function(x)


def means(x: Tensor) -> Tensor:
    return x.mean(dim=(2, 3))


def loaded(network: Callable[[Tensor], Any] | nn.Module, **changes: Any) -> Target:
    """The target of a network, tried. `changes`: of the card, of the target, or the labels it is registered with."""
    registered = changes.pop("registered", LABELS)
    card = {k: changes.pop(k) for k in ("classes",) if k in changes}
    card |= {"input_size": changes.pop("card_size", SIZE)}

    def load(dtype: torch.dtype) -> Target:
        module = network if isinstance(network, nn.Module) else Function(network)
        settings: dict[str, Any] = {"labels": LABELS, "input_size": SIZE, "dtype": dtype} | changes
        return Classifier("mine", module, mean=(0.0,) * 3, std=(1.0,) * 3, weights_sha256="0" * 64, **settings)

    add(lambda: registered, load, **card)
    return registry.load("mine")


MISTAKES: dict[str, tuple[Callable[[], Target], str]] = {
    "another input size": (
        lambda: loaded(nn.Sequential(nn.Flatten(), nn.Linear(3 * 16 * 16, 3))),
        r"fails on 2 RGB images of its input_size 8×8: RuntimeError: mat1 and mat2 shapes",
    ),
    "one channel": (
        lambda: loaded(nn.Sequential(nn.Conv2d(1, 3, 8), nn.Flatten())),
        r"fails on 2 RGB images of its input_size 8×8: RuntimeError: .*to have 1 channels, but got 3",
    ),
    "no tensor": (
        lambda: loaded(lambda x: (means(x), x)),
        r"fails on 2 RGB images .*: TypeError: it returns tuple, not a tensor of scores \[B, K\]; wrap it",
    ),
    "a card of another size": (lambda: loaded(means, card_size=(16, 16)), r"input_size 8×8, but its card says 16×16"),
    "more scores than labels": (
        lambda: loaded(lambda x: means(x).repeat(1, 2)),
        r"returns torch.float32 \[2, 6\] for 2 images; floating-point \[2, 3\] is due, one score for each label",
    ),
    "scores that are whole numbers": (lambda: loaded(lambda x: means(x).argmax(1)), r"floating-point \[2, 3\] is due"),
    "labels that differ": (lambda: loaded(means, registered=("a", "b")), "has 3 labels once .* the 2 of its card"),
    "a label twice": (lambda: loaded(means, labels=("a", "a", "b"), registered=("a", "a", "b")), "label 'a' more than"),
    "a card with other classes": (lambda: loaded(means, classes=10), "has 3 labels, but its card says 10 classes"),
    "not a number": (lambda: loaded(lambda x: means(x) * float("nan")), "scores that are not finite"),
    "probabilities": (
        lambda: loaded(lambda x: means(x).softmax(1)),
        "returns probabilities, which sum to 1; return the scores before the softmax",
    ),
    "scores that depend on the batch": (
        lambda: loaded(lambda x: means(x) - means(x).mean(0)),
        "other scores when it is alone in its batch",
    ),
    "dropout that stays on": (lambda: loaded(lambda x: means(nn.functional.dropout(x))), "other scores .* dropout"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_refused_by_name(mistake: str) -> None:
    load, said = MISTAKES[mistake]
    torch.manual_seed(1)
    with pytest.raises(InvalidRequest, match=f"target 'mine' .*{said}") as refused:
        load()
    assert refused.value.field == "target.name"


def gone(*_: object) -> Any:
    raise OSError("weights.bin is not there")


def ends(*_: object) -> Any:
    raise SystemExit("no weights")


def has(*labels: object) -> Callable[..., Any]:
    return lambda *_: SimpleNamespace(labels=labels)


BROKEN: dict[str, tuple[Labels, Callable[..., Any], str]] = {
    "its loader raises": (lambda: LABELS, gone, "target 'mine' cannot be loaded: OSError: weights.bin is not there"),
    "its loader ends the process": (lambda: LABELS, ends, "target 'mine' cannot be loaded: SystemExit: no weights"),
    "its loader returns nothing": (lambda: LABELS, lambda _: None, "target 'mine' has 0 labels once it is loaded"),
    "it has other labels": (lambda: LABELS, has("red"), "target 'mine' has 1 labels once it is loaded"),
    "its labels raise": (gone, has(*LABELS), "target 'mine' cannot list its labels: OSError"),
    "its labels are nothing": (lambda: None, has(*LABELS), "target 'mine' cannot list its labels: TypeError"),
    "its labels are numbers": (lambda: (1, 2), has(1, 2), "'mine' has the label 1, which is no text"),
    "its labels cannot be shown": (lambda: ("a", "\udc80"), has("a", "\udc80"), r"'mine' has the label '\udc80'"),
    "its labels are the same": (lambda: ("a", "a"), has("a", "a"), "target 'mine' has the label 'a' more than once"),
    "a label is too long": (
        lambda: ("a", "b" * (LONGEST_LABEL + 1)),
        gone,
        "… of 301 characters; 300 are most",
    ),
    "one of very many labels is there twice": (
        lambda: (*map(str, range(100_000)), "99999"),
        gone,
        "has the label '99999' more than once",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_target_that_cannot_be_used_says_so(name: str) -> None:
    labels, load, words = BROKEN[name]
    add(labels, load)
    with pytest.raises(InvalidRequest) as failed:
        registry.load("mine")
    assert failed.value.field == "target.name"
    assert words in str(failed.value)


def test_labels_may_be_a_list() -> None:
    add(lambda: list(LABELS), has(*LABELS))
    assert registry.labels("mine") == LABELS


def test_an_unknown_target_is_the_requests_mistake() -> None:
    with pytest.raises(InvalidRequest, match=r"target\.name"):
        registry.load("gr")


def test_running_out_of_memory_is_not_the_targets_mistake() -> None:
    def load(_: torch.dtype) -> Target:
        raise MemoryError

    add(lambda: LABELS, load)
    with pytest.raises(JobFailure, match="out-of-memory: target 'mine' needs more memory than is left"):
        registry.load("mine")


@pytest.mark.parametrize("network", [means, lambda x: means(x).log_softmax(1), lambda x: 0 * means(x)])
def test_scores_log_probabilities_and_ties_are_taken(network: Callable[[Tensor], Tensor]) -> None:
    loaded(network)
    assert registry.has_gradient("mine")


@pytest.mark.parametrize("network", [lambda x: torch.eye(3)[:1].expand(len(x), 3) * 4, lambda x: means(x.detach())])
def test_a_network_without_gradients_is_taken_but_known(network: Callable[[Tensor], Tensor]) -> None:
    loaded(network)
    assert not registry.has_gradient("mine")
