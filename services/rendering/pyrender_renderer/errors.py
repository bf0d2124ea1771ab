"""How far rasterised images and their differences are from OpenGL's: measured for the plan, and again, for images,
while an attack runs.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from math import acos, pi, sqrt

import torch
from torch import Tensor

from services.rendering.image_error import ImageError, image_error
from services.rendering.plan import GradientError
from services.rendering.protocol import Parameters, Renderer

DRAWS = 5
"""Images at random places around the start, beside the start's own, that are drawn both ways for the plan."""
REACH = {"illumination": 0.3, "color": 0.3, "translation": 0.1, "rotation": 0.3, "camera": 0.3}
"""How far from the start these are in each attacked coordinate, at most: as far as attacks move."""
MARGIN = 2.0
"""By how much the largest error found is multiplied, to estimate that of any other image."""
FEW = 4
"""Pixels of which a sample may flip in an image though none did in those that were measured."""
LINE = 0.5
"""Pixels that may be off because a face has come to be seen from its edge, where two ways to interpolate differ most:
a line of this length, in sides of a square of as many pixels as are covered. Few of them are off by much."""
EVERY = 128
"""One image in so many of an attack is drawn by OpenGL too."""
HALF_STEP = 0.01
"""Half-step of the central differences whose error is measured, in the groups' units."""
MAX_COORDINATES = 12
"""Maximum number of coordinates of a group whose differences are measured: of each object one, then another."""
GRADIENT_SHARE = 100.0
"""Relative error of a group's gradient that a tolerance of 1 would allow: a tenth at the default tolerance."""


def around(renderer: Renderer, groups: tuple[str, ...]) -> Parameters:
    """The start and DRAWS places around it, {group: [1 + DRAWS, ...]}; the same ones every time."""
    random = torch.Generator().manual_seed(0)
    places, bounds = {}, renderer.bounds()
    for group, value in renderer.initial().items():
        reach = REACH[group] if group in groups else 0.0
        moves = 2 * torch.rand(DRAWS + 1, *value.shape, generator=random, dtype=value.dtype) - 1
        moves[0] = 0.0
        places[group] = torch.clamp(value + reach * moves, *bounds[group])
    return places


def measure(
    renderer: Renderer, behind: Callable[[Parameters], Tensor], groups: tuple[str, ...]
) -> tuple[ImageError, int]:
    """The largest error of the renderer's images around the start, and the fewest pixels that one of them covers.

    `behind` returns what is behind the objects, [3] or [H, W, 3], at parameters {group: [1, ...]}.
    """
    worst, fewest, places = ImageError(), torch.iinfo(torch.int64).max, around(renderer, groups)
    for row, (image, exact) in enumerate(zip(renderer.render(places), renderer.exact().render(places), strict=True)):
        ground = behind({group: value[row : row + 1] for group, value in places.items()})
        error, covered = image_error(image, exact, ground)
        worst, fewest = worst.or_worse(error), min(fewest, covered)
    return worst, fewest


def refusal(error: ImageError, gradients: Sequence[GradientError], tolerance: float) -> str | None:
    """Why errors of images and of gradients are beyond the tolerance, as a clause; None if they are within it."""
    if not ImageError(MARGIN * error.mean, MARGIN * error.share).within(tolerance):
        return "twice its error is beyond the tolerance"
    if any(one.relative > GRADIENT_SHARE * tolerance for one in gradients):
        return "the error of its gradients is beyond the tolerance"
    return None


def estimated(measured: ImageError, covered: int) -> ImageError:
    """The estimated largest error of an image that was not measured and covers at least `covered` pixels."""
    flips, line = FEW / covered, LINE / sqrt(covered)
    return ImageError(MARGIN * measured.mean + flips / 4, MARGIN * measured.share + max(flips, line))


def measure_gradients(renderer: Renderer, opengl: Renderer, groups: tuple[str, ...]) -> tuple[GradientError, ...]:
    """Errors of the central differences of the renderer's images at the start against `opengl`'s, by attacked group.

    They are the expected errors of the gradient of a sum of the displayed values with normally distributed random
    weights: its relative error is that of the differences of images, in length, and its sign is wrong with probability
    θ / π, where θ is the angle between the two differences. Coordinates that change nothing do not count, and one that
    changes the image of only one of them counts as a wrong sign.
    """
    found = []
    for group in groups:
        sides = sides_of(renderer.initial(), group)
        ours, exact = (
            (at[::2] - at[1::2]).double().flatten(1) for at in (renderer.render(sides), opengl.render(sides))
        )
        length, error = float(exact.norm()), float((ours - exact).norm())
        angles = [
            acos(max(-1.0, min(1.0, float(own @ true) / float(own.norm() * true.norm()))))
            if own.any() and true.any()
            else pi  # a difference that only one of them has is of no sign in the other
            for own, true in zip(ours, exact, strict=True)
            if own.any() or true.any()
        ]
        relative = error / length if length else float(error > 0)
        wrong_signs = sum(angles) / (pi * len(angles)) if angles else 0.0
        found.append(GradientError(part="", group=group, relative=relative, wrong_signs=wrong_signs))
    return tuple(found)


def sides_of(start: Parameters, group: str) -> Parameters:
    """`start` with each of at most MAX_COORDINATES coordinates of a group moved up, then down, {group: [B, ...]}."""
    count = start[group].numel()
    # Three coordinates are an object's: one of each object, along axes in turn, then a second, then the third.
    triples = range(-(-count // 3))
    places = [3 * number + (number + turn) % 3 for turn in range(3) for number in triples]
    chosen = torch.tensor([place for place in places if place < count][:MAX_COORDINATES])
    steps = HALF_STEP * torch.nn.functional.one_hot(chosen, count).to(start[group].dtype)
    moves = torch.stack([steps, -steps], dim=1).reshape(-1, *start[group].shape)
    sides = {name: value.expand(len(moves), *value.shape) for name, value in start.items()}
    return sides | {group: start[group] + moves}


def is_sampled(parameters: Mapping[str, Tensor], row: int) -> bool:
    """Whether OpenGL draws this image of a batch too; its parameters decide, so nothing that was drawn before does."""
    key = b"".join(parameters[group][row].double().numpy().tobytes() for group in sorted(parameters))
    return zlib.crc32(key) % EVERY == 0
