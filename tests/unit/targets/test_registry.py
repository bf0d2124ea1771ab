"""Targets that cannot be loaded, or are not what they are registered as, say so by name."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from services.errors import InvalidRequest
from services.targets import registry
from services.targets.info import TARGETS, TargetInfo, register

LABELS = ("red", "green")
Labels = Callable[[], Any]


@pytest.fixture
def target() -> Iterator[Callable[[Labels, Callable[..., Any]], None]]:
    """Registers a target "rg" of these labels and this loader for one test."""
    before = TARGETS.snapshot()

    def add(labels: Labels, load: Callable[..., Any]) -> None:
        card = {"title": "", "task": "classification", "input_size": (1, 1), "classes": 2, "differentiable": True}
        info = TargetInfo.model_validate(card | {"name": "rg", "takes_question": False, "source": "", "licence": ""})
        register(info, labels)(load)

    yield add
    TARGETS.restore(before)
    registry.load.cache_clear()


def gone(*_: object) -> Any:
    raise OSError("weights.bin is not there")


def ends(*_: object) -> Any:
    raise SystemExit("no weights")


def has(*labels: object) -> Callable[..., Any]:
    return lambda *_: SimpleNamespace(labels=labels)


BROKEN: dict[str, tuple[Labels, Callable[..., Any], str]] = {
    "its loader raises": (lambda: LABELS, gone, "target 'rg' cannot be loaded: OSError: weights.bin is not there"),
    "its loader ends the process": (lambda: LABELS, ends, "target 'rg' cannot be loaded: SystemExit: no weights"),
    "its loader returns nothing": (lambda: LABELS, lambda _: None, "target 'rg' has 0 labels once it is loaded"),
    "it has other labels": (lambda: LABELS, has("red"), "target 'rg' has 1 labels once it is loaded"),
    "its labels raise": (gone, has(*LABELS), "target 'rg' cannot list its labels: OSError"),
    "its labels are nothing": (lambda: None, has(*LABELS), "target 'rg' cannot list its labels: TypeError"),
    "its labels are numbers": (lambda: (1, 2), has(1, 2), "'rg' has the label 1, which is no text"),
    "its labels cannot be shown": (lambda: ("a", "\udc80"), has("a", "\udc80"), r"'rg' has the label '\udc80'"),
    "its labels are the same": (lambda: ("a", "a"), has("a", "a"), "target 'rg' has the label 'a' more than once"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_target_that_cannot_be_used_says_so(name: str, target: Callable[..., None]) -> None:
    labels, load, words = BROKEN[name]
    target(labels, load)
    with pytest.raises(InvalidRequest) as failed:
        registry.load("rg")
    assert failed.value.field == "target.name"
    assert words in str(failed.value)


def test_labels_may_be_a_list(target: Callable[..., None]) -> None:
    target(lambda: list(LABELS), has(*LABELS))
    assert registry.labels("rg") == LABELS


def test_an_unknown_target_is_the_requests_mistake() -> None:
    with pytest.raises(InvalidRequest, match=r"target\.name"):
        registry.load("gr")
