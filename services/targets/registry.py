"""Finds and loads targets by name. Loading reads the weights, once per process."""

from functools import lru_cache

import torch

from services.errors import InvalidRequest, JobFailure
from services.targets.info import TARGETS, RegisteredTarget, TargetInfo, available
from services.targets.protocol import Target

__all__ = ["TargetInfo", "available", "labels", "load"]


def labels(name: str) -> tuple[str, ...]:
    """Returns the labels of a target, without loading it. Raises InvalidRequest("target.name") for an unknown name."""
    return _known(name).labels()


@lru_cache(maxsize=4)
def load(name: str, dtype: torch.dtype = torch.float32) -> Target:
    """The target, with its weights.

    Raises InvalidRequest("target.name") for an unknown one, JobFailure("internal") for one whose labels are not those
    it is registered with, or not unique.
    """
    known = _known(name)
    target, labels = known.load(dtype), known.labels()
    found = tuple(getattr(target, "labels", ()))
    if found != labels or len(set(labels)) != len(labels):
        raise JobFailure("internal", f"the labels of target {name!r} are not unique, or others once it is loaded")
    return target


def _known(name: str) -> RegisteredTarget:
    if name not in TARGETS:
        raise InvalidRequest("target.name", f"there is no target {name!r}; there is: {', '.join(TARGETS)}")
    return TARGETS[name]
