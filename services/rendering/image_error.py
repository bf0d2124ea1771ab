"""The error of an image that stands in for an exact one, in two numbers, and what a tolerance allows it to be.

At a silhouette one sample more or less changes a pixel by a quarter of its contrast, however small the difference in
arithmetic: the largest error of an image says next to nothing. So an error is two numbers: the mean over the covered
pixels, and the share of them that are off by more than a step of an 8-bit image. A tolerance t allows a mean of t and a
share of SHARE t: at the default of 1e-3 a quarter of a step, and one pixel in a hundred.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the API reads results without torch
    from torch import Tensor

STEP = 1 / 255
"""Errors of a displayed value that are not more than this are not counted in the share."""
SHARE = 10.0
"""Share of pixels beyond STEP that a tolerance of 1 would allow."""


@dataclass(frozen=True)
class ImageError:
    """Mean absolute error of the displayed values of covered pixels, and the share of them off by more than 1/255."""

    mean: float = 0.0
    share: float = 0.0

    def within(self, tolerance: float) -> bool:
        """Whether a tolerance allows it."""
        return self.mean <= tolerance and self.share <= SHARE * tolerance

    def or_worse(self, other: "ImageError | None") -> "ImageError":
        """The larger of both numbers, if there is another error."""
        return self if other is None else ImageError(max(self.mean, other.mean), max(self.share, other.share))


def image_error(image: "Tensor", exact: "Tensor", ground: "Tensor") -> tuple[ImageError, int]:
    """The error of a displayed image [H, W, 3] against the exact one, and the number of pixels that are covered: those
    of the exact image that differ from the `ground`, [3] or [H, W, 3], at least 1."""
    off = (image - exact).abs()
    covered = max(1, int((exact != ground).any(dim=-1).sum()))
    mean = float(off.double().mean(dim=-1).sum()) / covered
    return ImageError(mean, int((off.amax(dim=-1) > STEP).sum()) / covered), covered
