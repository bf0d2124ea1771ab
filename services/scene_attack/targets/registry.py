"""Finds and loads targets by name, once per process, and tries each after it is loaded.

A target that breaks its protocol is so refused before a job is queued.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache

import torch
from torch import Tensor

from scene_attack.errors import InvalidRequest
from scene_attack.process import finite
from scene_attack.targets.info import ANY_QUESTION, TARGETS, TargetInfo, known, register
from scene_attack.targets.labels import in_words, labels, refused
from scene_attack.targets.protocol import QuestionTarget, Target

__all__ = ["card", "has_gradient", "labels", "load", "no_gradient", "registered", "with_question"]

_REPEATED = 0.01
"""Largest difference between two scores of one image, relative to the largest score. Another batch changes the last
bits of a sum; dropout, or batch normalisation over the batch, changes far more."""
_SUM = 1e-4
"""Largest difference between 1 and the sum of float32 probabilities."""


def card(name: str) -> TargetInfo:
    """Returns a target's model card. Raises InvalidRequest("target.name") for an unknown name."""
    return known(name).info


@lru_cache(maxsize=4)
@torch.no_grad()
def load(name: str, dtype: torch.dtype = torch.float32) -> Target:
    """Returns the target, with its weights, after it was tried.

    Raises InvalidRequest("target.name"), which says what is wrong, for an unknown one, and if it cannot be loaded,
    differs from its card or its labels, or fails on two images of random pixels: if it raises an error, or returns
    other than one finite score for each label, probabilities, or other scores when an image is given again alone.
    """
    info, listed = card(name), labels(name)
    try:
        target = known(name).load(dtype)
        loaded = tuple(getattr(target, "labels", ()))
    except (Exception, SystemExit) as error:
        raise refused(name, f"cannot be loaded: {in_words(name, error)}") from error
    if loaded != listed:
        raise refused(name, f"has {len(loaded)} labels once it is loaded; they are not the {len(listed)} of its card")
    if info.classes != len(listed):
        raise refused(name, f"has {len(listed)} labels, but its card says {info.classes} classes")
    height, width = info.input_size
    if tuple(target.input_size) != (height, width):
        size = "×".join(map(str, target.input_size))
        raise refused(name, f"has input_size {size}, but its card says {height}×{width}")
    images = _images(target).to(dtype)
    asked = with_question(target, info.example)
    scores = _scores(name, asked, images)
    _check_scores(name, scores, listed)
    alone = _scores(name, asked, images[:1])
    difference, largest = float((alone - scores[:1]).abs().max()), float(scores.abs().max())
    if difference > _REPEATED * largest:
        raise refused(
            name,
            f"gives an image other scores when it is alone in its batch, by {difference:.2g}: scores may depend on "
            "nothing else (is dropout or batch normalisation in training mode?)",
        )
    return target


def with_question(target: Target, example: str | None) -> Target:
    """Returns the target, asked its card's example where it takes a question, or any question if its card has none."""
    return target.asked(example or ANY_QUESTION) if isinstance(target, QuestionTarget) else target


def _images(target: Target) -> Tensor:
    """Returns two images of random pixels in the size of the target's input, float32 [2, H, W, 3]."""
    return torch.rand((2, *target.input_size, 3), generator=torch.Generator().manual_seed(0))


def _scores(name: str, target: Target, images: Tensor) -> Tensor:
    try:
        return target.logits(images)
    except (Exception, SystemExit) as error:
        size = "×".join(map(str, target.input_size))
        raise refused(
            name, f"fails on {len(images)} RGB images of its input_size {size}: {in_words(name, error)}"
        ) from error


def _check_scores(name: str, scores: Tensor, labels: Sequence[str]) -> None:
    shape = (2, len(labels))
    if not isinstance(scores, Tensor) or scores.shape != shape or not scores.is_floating_point():
        returned = f"{scores.dtype} {list(scores.shape)}" if isinstance(scores, Tensor) else type(scores).__name__
        raise refused(
            name, f"returns {returned} for 2 images; floating-point {list(shape)} is due, one score for each label"
        )
    if not finite(scores):
        raise refused(name, "returns scores that are not finite")
    if bool((scores >= 0).all()) and bool(((scores.sum(dim=1) - 1).abs() < _SUM).all()):
        raise refused(
            name,
            "returns probabilities, which sum to 1; return the scores before the softmax, or the logarithms of the "
            'probabilities, or state "output": "probabilities" in its card',
        )


@lru_cache(maxsize=64)
def has_gradient(name: str) -> bool:
    """Whether the target's scores have a gradient with respect to the images: its card, it and torch say so. Raises as
    `load` does.
    """
    info = card(name)
    if info.differentiable is False or not (target := load(name)).differentiable:
        return False
    images = _images(target)[:1].requires_grad_()
    return with_question(target, info.example).logits(images).requires_grad


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
