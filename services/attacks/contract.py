"""What renderers, networks and methods owe an attack, checked where it takes what they return.

An extension that breaks its protocol must end its job with a reason. Unchecked, most of what it may return is a result:
values beyond [0,1] are clipped when the image is saved, and scores that are no numbers have a largest one too.
"""

import json
from collections.abc import Mapping

import torch
from torch import Tensor

from services.errors import JobFailure, summary
from services.finite import finite
from services.rendering.protocol import BOUND_SLACK, Renderer
from services.targets.protocol import Target

SLACK = 1e-4
"""How far rounding may take a displayed value out of [0,1]; a fortieth of a step of an 8-bit image."""


def check_images(renderer: Renderer, images: Tensor, count: int) -> None:
    """Raises JobFailure unless `images` are `count` images of the renderer's size, with values in [0,1]."""
    shape = (count, *renderer.size, 3)
    if not isinstance(images, Tensor) or images.shape != shape or not images.is_floating_point():
        raise _internal("renderer", renderer.name, "images", shape, images)
    low, high = (float(value) for value in torch.aminmax(images.detach()))
    if not torch.tensor([low, high]).isfinite().all():
        raise JobFailure("non-finite", "the renderer returned an image with values that are not finite")
    if low < -SLACK or high > 1 + SLACK:
        found = f"an image with values from {low:g} to {high:g}, not in [0,1]"
        raise JobFailure("internal", f"renderer {renderer.name!r} returned {found}")


def check_scores(target: Target, scores: Tensor, count: int) -> None:
    """Raises JobFailure unless `scores` are finite, one row an image and one score a label."""
    shape = (count, len(target.labels))
    if not isinstance(scores, Tensor) or scores.shape != shape or not scores.is_floating_point():
        raise _internal("target", target.name, "scores", shape, scores)
    if not finite(scores):
        raise JobFailure("non-finite", "the network returned scores that are not finite")


def check_graph(renderer: Renderer, target: Target, images: Tensor, scores: Tensor) -> None:
    """Raises JobFailure unless the scores of `images` can be differentiated, where a gradient is needed."""
    if not scores.requires_grad:
        whose = (
            f"target {target.name!r} returned scores"
            if images.requires_grad
            else f"renderer {renderer.name!r} returned images"
        )
        raise JobFailure(
            "internal", f"{whose} without a graph; a gradient is needed, and it is said to be differentiable"
        )


def check_perturbation(
    given: Mapping[str, Tensor], initial: Mapping[str, Tensor], bounds: Mapping[str, tuple[Tensor, Tensor]]
) -> None:
    """Raises JobFailure unless a method's perturbation has the attacked groups in their shapes, and values that are
    finite and within `bounds`, the smallest and largest perturbation of each group that has any.
    """
    if not isinstance(given, Mapping) or not all(isinstance(value, Tensor) for value in given.values()):
        raise JobFailure("internal", "the method's perturbation is no tensor for each group")
    shapes = {group: tuple(value.shape) for group, value in given.items()}
    expected = {group: tuple(value.shape) for group, value in initial.items()}
    if shapes != expected:
        raise JobFailure("internal", f"the method's perturbation has the groups {shapes}; attacked are {expected}")
    for group, value in given.items():
        if not value.is_floating_point():
            raise JobFailure("internal", f"the perturbation of group {group!r} is of {value.dtype}, not floating-point")
        if not finite(value):
            raise JobFailure("non-finite", f"the perturbation of group {group!r} has values that are not finite")
        low, high = bounds.get(group, (value, value))
        beyond = torch.maximum(low - value, value - high).detach()
        if bool((beyond > BOUND_SLACK * (1 + initial[group].abs())).any()):
            raise JobFailure(
                "internal",
                f"the method left the bounds of group {group!r} by up to {float(beyond.max()):g}; "
                "AttackProblem.clamp keeps a perturbation within them",
            )


def check_settings(found: object) -> None:
    """Raises JobFailure unless `Method.start` returned a dict that can be stored as JSON."""
    try:
        if isinstance(found, dict):
            json.dumps(found, allow_nan=False)
            return
    except (TypeError, ValueError) as error:
        raise JobFailure("internal", f"the settings that the method measured are not JSON: {summary(error)}") from error
    raise JobFailure("internal", f"the method's start returned a {type(found).__name__}; a dict of settings is due")


def check_state(state: object) -> None:
    """Raises JobFailure unless `Method.state` returned tensors by name, which a checkpoint can save."""
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise JobFailure("internal", "the method's state is no dict of tensors; a checkpoint could not save it")


def check_count(count: object) -> None:
    """Raises JobFailure unless `Method.advance` returned a count."""
    if not isinstance(count, int) or count < 0:
        raise JobFailure("internal", f"the method's advance returned {count!r:.80}; a count from 0 is due")


def _internal(kind: str, name: str, what: str, shape: tuple[int, ...], given: object) -> JobFailure:
    found = f"{given.dtype} of {list(given.shape)}" if isinstance(given, Tensor) else type(given).__name__
    return JobFailure("internal", f"{kind} {name!r} returned {what} as {found}; floating-point {list(shape)} is due")
