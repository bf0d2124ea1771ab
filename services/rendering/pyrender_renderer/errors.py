"""How far rasterised images are from OpenGL's, and what a tolerance allows them to be.

At a silhouette one sample more or less changes a pixel by a quarter of its contrast, however small the difference in
arithmetic: the largest error of an image says next to nothing. So an error is two numbers: the mean over the covered
pixels, and the share of them that are off by more than a step of an 8-bit image. A tolerance t allows a mean of t and a
share of SHARE t: at the default of 1e-3 a quarter of a step, and one pixel in a hundred.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from services.rendering.protocol import Parameters, Renderer

STEP = 1 / 255
"""Errors of a displayed value that are not more than this are not counted in the share."""
SHARE = 10.0
"""Share of pixels beyond STEP that a tolerance of 1 would allow."""
DRAWS = 5
"""Images at random places around the start, beside the start's own, that are drawn both ways for the plan."""
REACH = {"illumination": 0.3, "color": 0.3, "translation": 0.1, "rotation": 0.3}
"""How far from the start these are in each attacked coordinate, at most: as far as attacks move."""
MARGIN = 2.0
"""By how much the largest error found is multiplied, to estimate that of any other image."""
FEW = 4
"""Pixels of which a sample may flip in an image though none did in those that were measured."""
EVERY = 128
"""One image in so many of an attack is drawn by OpenGL too."""


@dataclass(frozen=True)
class ImageError:
    """Mean absolute error of the displayed values of covered pixels, and the share of them off by more than STEP."""

    mean: float = 0.0
    share: float = 0.0

    def within(self, tolerance: float) -> bool:
        """Whether a tolerance allows it."""
        return self.mean <= tolerance and self.share <= SHARE * tolerance

    def or_worse(self, other: "ImageError") -> "ImageError":
        """The larger of both numbers."""
        return ImageError(max(self.mean, other.mean), max(self.share, other.share))


def image_error(image: Tensor, exact: Tensor, ground: Tensor) -> tuple[ImageError, int]:
    """Of a displayed image [H, W, 3] against the exact one, over a `ground` [3]; and how many pixels are covered."""
    off = (image - exact).abs()
    covered = max(1, int((exact != ground).any(dim=-1).sum()))
    mean = float(off.mean(dim=-1, dtype=torch.float64).sum()) / covered
    return ImageError(mean, int((off.amax(dim=-1) > STEP).sum()) / covered), covered


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


def measure(renderer: Renderer, ground: Tensor, groups: tuple[str, ...]) -> tuple[ImageError, int]:
    """The largest error of the renderer's images around the start, and the fewest pixels that one of them covers."""
    worst, fewest, places = ImageError(), torch.iinfo(torch.int64).max, around(renderer, groups)
    for image, exact in zip(renderer.render(places), renderer.exact().render(places), strict=True):
        error, covered = image_error(image, exact, ground)
        worst, fewest = worst.or_worse(error), min(fewest, covered)
    return worst, fewest


def estimated(measured: ImageError, covered: int) -> ImageError:
    """What the error of an image that was not measured is taken to be at most; `covered`: its pixels, at least."""
    flips = FEW / covered
    return ImageError(MARGIN * measured.mean + flips / 4, MARGIN * measured.share + flips)


def is_sampled(parameters: Mapping[str, Tensor], row: int) -> bool:
    """Whether OpenGL draws this image of a batch too; its parameters decide, so nothing that was drawn before does."""
    key = b"".join(parameters[group][row].double().numpy().tobytes() for group in sorted(parameters))
    return zlib.crc32(key) % EVERY == 0
