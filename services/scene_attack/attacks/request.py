"""Settings of attacks that others read too: the loss, the seed, and the range of views, light and cameras over which an
adversary is to hold. This module does not import torch.
"""

from collections.abc import Sequence
from typing import Annotated, Literal, get_args

from pydantic import Field, model_validator

from scene_attack.rendering.declaration import Declaration
from scene_attack.rendering.sensor.settings import SensorRange
from scene_attack.strict import Model, absent

Degrees = Annotated[float, Field(ge=0, le=180, allow_inf_nan=False)]
Relative = Annotated[float, Field(ge=0, le=0.9, allow_inf_nan=False)]
VIEWS = ("azimuth", "elevation", "distance", "roll")
RANGES = (*VIEWS, "intensity")

Loss = Literal["log-odds", "margin", "dlr"]
LOSSES: tuple[Loss, ...] = get_args(Loss)
LOSS_DESCRIPTION = (
    "what is minimised: `log-odds` of the label to leave (in place of cross-entropy, whose direction it has), `margin` "
    "of its score over the largest other, or `dlr`, the margin divided by the spread of the largest scores"
)
LARGEST_SEED = 2**63 - 1
Seed = Annotated[int, Field(ge=0, le=LARGEST_SEED)]


class Expectation(Model):
    """A range of views, light and cameras over which the adversary is to hold (Athalye et al. 2018). Each step lowers
    the mean objective over the scene itself and `samples` variations of it, drawn anew. Each range is the half-width of
    a uniform distribution about the scene's own value; `sensor` has ranges of its own.
    """

    azimuth: Degrees = Field(default=0.0, description="of the camera's azimuth, degrees")
    elevation: Degrees = Field(default=0.0, description="of the camera's elevation, degrees")
    roll: Degrees = Field(default=0.0, description="of the camera's roll, degrees")
    distance: Relative = Field(default=0.0, description="of the camera's distance, as a share of it")
    intensity: Relative = Field(default=0.0, description="of the light's intensity, as a share of it")
    sensor: SensorRange | None = Field(
        default=None,
        exclude_if=absent,
        description="cameras that take the image; {} is a range of ordinary ones, null the image as it is rendered",
    )
    samples: Annotated[int, Field(ge=0, le=64)] = Field(
        default=4,
        description="variations of a step; each image of the attack becomes 1 + `samples` images and queries; 0: the "
        "attack is of the scene itself alone, and the result measures the share for comparison",
    )
    checks: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=100,
        description="fresh variations on which the result measures the share that is fooled, after the attack",
    )

    @model_validator(mode="after")
    def _a_range(self) -> "Expectation":
        if self.sensor is None and not any(getattr(self, name) for name in RANGES):
            raise ValueError(f"give a range above 0 to one of {', '.join(RANGES)}, or a `sensor`")
        return self

    def check(self, renderer: Declaration, groups: Sequence[str]) -> None:
        """Raises ValueError for a range that the renderer cannot draw, or not while these groups are attacked."""
        views = [name for name in VIEWS if getattr(self, name)]
        pixels = [name for name in groups if renderer.group(name).per_pixel]
        if views and pixels:
            raise ValueError(
                f"expectation.{views[0]}: {pixels[0]} belong to the pixels of one view, and no other view has them; "
                "attack groups of the object, or leave the range out"
            )
        for name in RANGES:
            if getattr(self, name) and name not in renderer.varies:
                can = ", ".join([*renderer.varies, "sensor"])
                raise ValueError(f"expectation.{name}: renderer {renderer.name} can draw a range of {can} only")
