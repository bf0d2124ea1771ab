"""Tries a target once after it is loaded, so that one that breaks its protocol is refused before a job is queued."""

from collections.abc import Sequence

import torch
from torch import Tensor

from services.process import finite
from services.targets.info import RegisteredTarget
from services.targets.labels import in_words, labels, refused
from services.targets.protocol import QuestionTarget, Target

ANY_QUESTION = "What is this?"
"""The question to a target whose card has no example of one."""
_REPEATED = 0.01
"""Largest difference between two scores of one image, relative to the largest score. Another batch changes the last
bits of a sum; dropout, or batch normalisation over the batch, changes far more."""
_SUM = 1e-4
"""Largest difference between 1 and the sum of float32 probabilities."""


@torch.no_grad()
def load(name: str, known: RegisteredTarget, dtype: torch.dtype) -> Target:
    """Loads a target and tries it.

    Raises InvalidRequest("target.name"), which says what is wrong, if it cannot be loaded, differs from its card or its
    labels, or fails on two images of random pixels: if it raises an error, or returns other than one finite score for
    each label, probabilities, or other scores when an image is given again alone.
    """
    listed = labels(name, known)
    try:
        target = known.load(dtype)
        loaded = tuple(getattr(target, "labels", ()))
    except (Exception, SystemExit) as error:
        raise refused(name, f"cannot be loaded: {in_words(name, error)}") from error
    _check_labels(name, known, loaded, listed)
    height, width = known.info.input_size
    if tuple(target.input_size) != (height, width):
        size = "×".join(map(str, target.input_size))
        raise refused(name, f"has input_size {size}, but its card says {height}×{width}")
    images = _images(target).to(dtype)
    asked = with_question(target, known.info.example)
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


def has_gradient(target: Target, example: str | None = None) -> bool:
    """Whether the target's scores have a gradient with respect to the images: it says so, and torch agrees.

    example: a question that it takes.
    """
    if not target.differentiable:
        return False
    images = _images(target)[:1].requires_grad_()
    return with_question(target, example).logits(images).requires_grad


def with_question(target: Target, example: str | None) -> Target:
    """Returns the target, asked its card's example where it takes a question, or any question if its card has none."""
    return target.asked(example or ANY_QUESTION) if isinstance(target, QuestionTarget) else target


def _images(target: Target) -> Tensor:
    """Returns two images of random pixels in the size of the target's input, float32 [2, H, W, 3]."""
    return torch.rand((2, *target.input_size, 3), generator=torch.Generator().manual_seed(0))


def _check_labels(name: str, known: RegisteredTarget, loaded: Sequence[str], listed: Sequence[str]) -> None:
    if tuple(loaded) != tuple(listed):
        raise refused(name, f"has {len(loaded)} labels once it is loaded; they are not the {len(listed)} of its card")
    if known.info.classes != len(listed):
        raise refused(name, f"has {len(listed)} labels, but its card says {known.info.classes} classes")


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
