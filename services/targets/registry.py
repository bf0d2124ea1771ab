"""Finds and loads targets by name. Loading reads the weights, once per process."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import torch

from services.errors import InvalidRequest
from services.targets import labels as listing
from services.targets import probe
from services.targets.info import TARGETS, TargetInfo, available, known, register
from services.targets.protocol import Target

__all__ = ["TargetInfo", "available", "card", "has_gradient", "labels", "load", "no_gradient", "registered"]


def labels(name: str) -> tuple[str, ...]:
    """Returns the labels of a target, without loading it.

    Raises InvalidRequest("target.name") for an unknown name, and for labels that cannot be listed or are not unique.
    """
    return listing.labels(name, known(name))


def card(name: str) -> TargetInfo:
    """Returns a target's model card. Raises InvalidRequest("target.name") for an unknown name."""
    return known(name).info


@lru_cache(maxsize=4)
def load(name: str, dtype: torch.dtype = torch.float32) -> Target:
    """Returns the target, with its weights.

    Raises InvalidRequest("target.name") for an unknown one, and for one that breaks its protocol (`probe.load`).
    """
    return probe.load(name, known(name), dtype)


@lru_cache(maxsize=64)
def has_gradient(name: str) -> bool:
    """Whether the target's scores have a gradient with respect to the images: its card, it and torch say so. Raises as
    `load` does.
    """
    return known(name).info.differentiable is not False and probe.has_gradient(load(name), card(name).example)


def no_gradient(name: str) -> str:
    """Returns the reason for which a target without gradients has none."""
    reason = getattr(load(name), "scores_only", None)
    return reason or "they are constant, detached or computed without torch"


@contextmanager
def registered(info: TargetInfo, target: Target) -> Iterator[None]:
    """Makes a target of this process known under its name for as long as the context lasts.

    Raises InvalidRequest("name") for a name that is taken, or that is not made of a-z, 0-9, - and _.
    """
    before = TARGETS.snapshot()
    try:
        register(info, lambda: target.labels)(lambda _: target)
    except ValueError as error:
        raise InvalidRequest("name", str(error)) from error
    try:
        yield
    finally:
        TARGETS.restore(before)
        load.cache_clear()
        has_gradient.cache_clear()
