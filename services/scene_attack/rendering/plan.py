"""A renderer's plan for a scene and a set of attacked groups: the steps of an image, the work left out, and the error.

A plan is made before the attack starts, stored with the result and shown on the job's page. The renderers hold the
executable form of it and run nothing that the plan does not list.

At a silhouette one sample more or less changes a pixel by a quarter of its contrast, however small the difference in
arithmetic: the largest error of an image says next to nothing. So the error of an image that stands in for an exact one
is two numbers: the mean over the covered pixels, and the share of them that are off by more than a step of an 8-bit
image. A tolerance t allows a mean of t and a share of SHARE_PER_TOLERANCE t: at the default of 1e-3 a quarter of a
step, and one pixel in a hundred.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pydantic import BaseModel, ConfigDict, Field

if TYPE_CHECKING:
    from torch import Tensor

Tolerance = float | Literal["exact"]
"""Largest error of a displayed value, in [0,1], that images inside the attack may have; "exact" allows no shortcut."""

DEFAULT_TOLERANCE = 1e-3
"""Default tolerance: about a quarter of a step of an 8-bit image."""


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Item(_Record):
    """A quantity that an image is computed from: how many of it are kept, and why the others are left out."""

    part: str = Field("", description='part of the image it is about: "object 0"; empty for all of it')
    what: str = Field(description='"pixels", "directions", "lobes", "coordinates", …')
    kept: int
    of: int
    why: str = Field(description="why the others are left out, or why all are kept")
    error: float = Field(0.0, description="largest change of a displayed value due to leaving them out")


class Stage(_Record):
    """A step of making an image."""

    part: str = Field("", description='part of the image it is about: "object 0"; empty for all of it')
    name: str
    method: str = Field(description="how it is done")
    when: Literal["once", "every image"]
    evaluations: int = Field(description="units of work each time it is done")
    unit: str = Field(description='what is counted: "lobe values", "lookups", "frames", …')
    why: str = Field(description="why this method")
    error: float = Field(
        0.0, description="estimated error of a displayed value that the method costs; of rasterised images the mean"
    )
    share: float = Field(
        0.0, description="estimated share of covered pixels whose error exceeds 1/255; rasterised images only"
    )


class GradientError(_Record):
    """Error of the gradient with respect to a group against the exact gradient, measured when the plan was made.

    The gradient is that of a sum of displayed values with normally distributed random weights. Of rasterised images it
    is made of central differences, whose exact values OpenGL's images have.
    """

    part: str = Field(description='part of the image it is about: "object 0"; empty for all of it')
    group: str
    relative: float = Field(description="length of the difference over the length of the exact gradient")
    wrong_signs: float = Field(
        description="share of the coordinates with a gradient whose sign differs; fgsm steps by signs"
    )


class Plan(_Record):
    """A renderer's plan: what is kept and what is left out, the steps, their methods, estimated costs and errors."""

    renderer: str
    groups: tuple[str, ...] = Field(description="the attacked groups: all others keep their values and no gradient")
    size: tuple[int, int] = Field(description="height and width")
    tolerance: Tolerance
    items: tuple[Item, ...]
    stages: tuple[Stage, ...]

    error: float = Field(
        description="estimated error of the displayed values of any image, by the measure that `error_is` names: the "
        "errors that meet in a part add up at worst"
    )
    error_is: Literal["maximum", "mean"] = Field(
        "maximum",
        description='"maximum": `error` is the largest difference of a displayed value; "mean": of rasterised images '
        "it is the mean over covered pixels, since at a silhouette one sample changes a pixel by a quarter",
    )
    gradients: tuple[GradientError, ...] = Field(
        (), description="errors of the gradients; empty where nothing is shortened or nothing is differentiated"
    )
    environment_map_error: float | None = Field(
        None,
        description="environment map's resolution: largest difference of a displayed value, at some pixels, to the "
        "same scene under the largest map, 64×128; not part of `error`. Null where no map is used or it is the largest",
    )

    @classmethod
    def of(
        cls,
        renderer: str,
        groups: Sequence[str],
        size: tuple[int, int],
        tolerance: Tolerance,
        items: Sequence[Item],
        stages: Sequence[Stage] = (),
        gradients: Sequence[GradientError] = (),
        error_is: Literal["maximum", "mean"] = "maximum",
    ) -> "Plan":
        """Makes the plan of these items and stages, and adds up their errors.

        Errors within a part add up; the plan's error is that of the worst part plus that of entries without a part.
        """
        errors: dict[str, float] = {}
        entries: list[Item | Stage] = [*items, *stages]
        for entry in entries:
            errors[entry.part] = errors.get(entry.part, 0.0) + entry.error
        return cls(
            renderer=renderer,
            groups=tuple(groups),
            size=size,
            tolerance=tolerance,
            items=tuple(items),
            stages=tuple(stages),
            gradients=tuple(gradients),
            error_is=error_is,
            error=errors.pop("", 0.0) + max(errors.values(), default=0.0),
        )


STEP = 1 / 255
"""Errors of a displayed value that are not more than this are not counted in the share."""
SHARE_PER_TOLERANCE = 10.0
"""Share of pixels beyond STEP that a tolerance of 1 would allow."""


@dataclass(frozen=True)
class ImageError:
    """Mean absolute error of the displayed values of covered pixels, and the share of them off by more than 1/255."""

    mean: float = 0.0
    share: float = 0.0

    def within(self, tolerance: float) -> bool:
        """Whether a tolerance allows it."""
        return self.mean <= tolerance and self.share <= SHARE_PER_TOLERANCE * tolerance

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
