"""Finds and loads targets by name. Loading reads the weights, once per process."""

from functools import lru_cache

import torch

from services.errors import InvalidRequest
from services.suggestions import there_are
from services.targets import probe
from services.targets.info import TARGETS, RegisteredTarget, TargetInfo, available
from services.targets.protocol import Target

__all__ = ["TargetInfo", "available", "card", "has_gradient", "labels", "load"]


def labels(name: str) -> tuple[str, ...]:
    """Returns the labels of a target, without loading it.

    Raises InvalidRequest("target.name") for an unknown name, and for labels that cannot be listed or are not unique.
    """
    return probe.labels(name, _known(name))


def card(name: str) -> TargetInfo:
    """Returns a target's model card. Raises InvalidRequest("target.name") for an unknown name."""
    return _known(name).info


@lru_cache(maxsize=4)
def load(name: str, dtype: torch.dtype = torch.float32) -> Target:
    """The target, with its weights.

    Raises InvalidRequest("target.name") for an unknown one, and for one that breaks its protocol (`probe.load`).
    """
    return probe.load(name, _known(name), dtype)


@lru_cache(maxsize=64)
def has_gradient(name: str) -> bool:
    """Whether the target's scores have a gradient with respect to the images: its card, it and torch say so. Raises as
    `load` does.
    """
    return _known(name).info.differentiable and probe.has_gradient(load(name))


def _known(name: str) -> RegisteredTarget:
    if name not in TARGETS:
        raise InvalidRequest("target.name", f"there is no target {name!r}; {there_are(name, TARGETS)}")
    return TARGETS[name]
