"""Networks that users bring, each with one mistake, and what is said of it before a job is queued."""

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from services.errors import InvalidRequest, JobFailure
from services.targets import probe
from services.targets.classifier import Classifier
from services.targets.info import LONGEST_LABEL, RegisteredTarget, TargetInfo
from services.targets.protocol import Target

LABELS = ("red", "green", "blue")
SIZE = (8, 8)


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
    card = {"input_size": SIZE, "classes": 3} | {k: changes.pop(k) for k in ("classes", "card_size") if k in changes}
    card["input_size"] = card.pop("card_size", SIZE)
    info = TargetInfo(
        name="mine",
        title="Mine",
        task="classification",
        differentiable=True,
        takes_question=False,
        source="a test",
        licence="CC0-1.0",
        **card,
    )

    def load(dtype: torch.dtype) -> Target:
        module = network if isinstance(network, nn.Module) else Function(network)
        settings: dict[str, Any] = {"labels": LABELS, "input_size": SIZE, "dtype": dtype} | changes
        return Classifier("mine", module, mean=(0.0,) * 3, scale=(1.0,) * 3, weights_sha256="0" * 64, **settings)

    return probe.load("mine", RegisteredTarget(info, lambda: registered, load), torch.float32)


MISTAKES: dict[str, tuple[Callable[[], Target], str]] = {
    "another input size": (
        lambda: loaded(nn.Sequential(nn.Flatten(), nn.Linear(3 * 16 * 16, 3))),
        r"fails on 2 RGB images of its input_size 8×8: RuntimeError: mat1 and mat2 shapes",
    ),
    "one channel": (
        lambda: loaded(nn.Sequential(nn.Conv2d(1, 3, 8), nn.Flatten())),
        r"fails on 2 RGB images of its input_size 8×8: RuntimeError: .*to have 1 channels, but got 3",
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


def test_a_target_that_cannot_be_loaded_says_why() -> None:
    def load(_: torch.dtype) -> Target:
        raise KeyError("conv1.weight")

    info = TargetInfo.model_construct(name="mine", input_size=SIZE, classes=3)
    with pytest.raises(InvalidRequest, match=r"target 'mine' cannot be loaded: KeyError: 'conv1.weight'"):
        probe.load("mine", RegisteredTarget(info, lambda: LABELS, load), torch.float32)


def test_running_out_of_memory_is_not_the_targets_mistake() -> None:
    def load(_: torch.dtype) -> Target:
        raise MemoryError

    info = TargetInfo.model_construct(name="mine", input_size=SIZE, classes=3)
    with pytest.raises(JobFailure, match="out-of-memory: target 'mine' needs more memory than is left"):
        probe.load("mine", RegisteredTarget(info, lambda: LABELS, load), torch.float32)


@pytest.mark.parametrize("network", [means, lambda x: means(x).log_softmax(1), lambda x: 0 * means(x)])
def test_scores_log_probabilities_and_ties_are_taken(network: Callable[[Tensor], Tensor]) -> None:
    assert probe.has_gradient(loaded(network))


@pytest.mark.parametrize("network", [lambda x: torch.eye(3)[:1].expand(len(x), 3) * 4, lambda x: means(x.detach())])
def test_a_network_without_gradients_is_taken_but_known(network: Callable[[Tensor], Tensor]) -> None:
    assert not probe.has_gradient(loaded(network))


@pytest.mark.parametrize(
    ("labels", "said"),
    [
        (("a", "b" * (LONGEST_LABEL + 1)), r"has the label 'bbb.* of 301 characters; 300 are most"),
        ((*map(str, range(100_000)), "99999"), "has the label '99999' more than once"),
    ],
)
def test_labels_that_no_goal_could_name_are_refused(labels: tuple[str, ...], said: str) -> None:
    info = TargetInfo.model_construct(name="mine")
    with pytest.raises(InvalidRequest, match=said):
        probe.labels("mine", RegisteredTarget(info, lambda: labels, lambda _: pytest.fail("not loaded")))
