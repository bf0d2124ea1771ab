"""How far rasterised images are from OpenGL's: measured for the plan, and again while an attack runs."""

import zlib
from collections.abc import Callable, Mapping
from math import sqrt

import torch
from torch import Tensor

from services.rendering.image_error import ImageError, image_error
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


def estimated(measured: ImageError, covered: int) -> ImageError:
    """The estimated largest error of an image that was not measured and covers at least `covered` pixels."""
    flips, line = FEW / covered, LINE / sqrt(covered)
    return ImageError(MARGIN * measured.mean + flips / 4, MARGIN * measured.share + max(flips, line))


def is_sampled(parameters: Mapping[str, Tensor], row: int) -> bool:
    """Whether OpenGL draws this image of a batch too; its parameters decide, so nothing that was drawn before does."""
    key = b"".join(parameters[group][row].double().numpy().tobytes() for group in sorted(parameters))
    return zlib.crc32(key) % EVERY == 0
