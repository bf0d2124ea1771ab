"""Settings of a camera between the scene and the network, and ranges of them. This module does not import torch."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from math import log2
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from scene_attack.strict import Model

if TYPE_CHECKING:
    from torch import Tensor

BASE_ISO = 100
"""The lowest ISO of a range; noise is stated relative to it."""
LOSSLESS = 100
"""The quality at which no JPEG file is made."""


@dataclass(frozen=True)
class Sensor:
    """How a camera takes an image. The defaults change nothing: each stage is left out at its own."""

    exposure: float = 0.0
    """Stops: the light is multiplied by 2 to this power."""
    red: float = 0.0
    """White balance: stops of the red channel over the green one."""
    blue: float = 0.0
    defocus: float = 0.0
    """Radius of the disc into which a point of light is spread, pixels."""
    motion: float = 0.0
    """Length of the image's straight path during the exposure, pixels."""
    direction: float = 0.0
    """Of that path, degrees from the right downwards."""
    iso: float = 0.0
    """Sensitivity, which decides the noise; 0: none."""
    sharpening: float = 0.0
    """Factor on what distinguishes a pixel from its neighbours, which is added to it."""
    resolution: float = 1.0
    """Factor on the image's height and width; it is then enlarged to its size again."""
    quality: int = LOSSLESS
    """Of the JPEG file, from 1; `LOSSLESS`: no file is made."""


PLAIN = Sensor()
"""A camera that changes nothing."""

GROUPS = {
    "exposure": {"exposure": 1.0, "red": 0.3, "blue": 0.3},
    "blur": {"defocus": 2.0, "motion": 4.0, "direction": 90.0},
    "noise": {"ISO": 3200.0, "sharpening": 2.0},
    "file": {"resolution": -0.5, "quality": -70.0},
}
"""The settings in the order of `Sensor`, by the parameter group that attacks them, each with its largest change from
`PLAIN` there. A coordinate of an attack is a share of it."""
TWO_SIDED = ("exposure", "red", "blue", "direction")
"""The settings that may change either way."""


def of_shares(shares: "Mapping[str, Tensor]") -> Sensor:
    """The sensor at coordinates by group, each a share of its largest change; the quality is rounded."""
    changes = [
        float(share) * most
        for group, settings in GROUPS.items()
        for share, most in zip(shares[group], settings.values(), strict=True)
    ]
    values = {name: start + change for (name, start), change in zip(asdict(PLAIN).items(), changes, strict=True)}
    return Sensor(**values | {"quality": round(values["quality"])})


class SensorRange(Model):
    """A range of cameras. The defaults are those of an ordinary photograph; a setting at the value that says so is left
    out. Each is drawn by itself, evenly, the ISO by stops.
    """

    exposure: Annotated[float, Field(ge=0, le=4, allow_inf_nan=False)] = Field(
        default=0.5, description="largest change of the exposure, stops, either way; 0: none"
    )
    white_balance: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = Field(
        default=0.2, description="largest change of the red and the blue channel, stops, either way; 0: none"
    )
    defocus: Annotated[float, Field(ge=0, le=32, allow_inf_nan=False)] = Field(
        default=1.0, description="largest radius of the disc into which a point of light is spread, pixels; 0: none"
    )
    motion: Annotated[float, Field(ge=0, le=64, allow_inf_nan=False)] = Field(
        default=2.0, description="largest path of the image during the exposure, in any direction, pixels; 0: none"
    )
    iso: Annotated[float, Field(ge=0, le=102_400, allow_inf_nan=False)] = Field(
        default=1600.0, description=f"largest ISO, from {BASE_ISO}, which decides the noise; 0: no noise"
    )
    sharpening: Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)] = Field(
        default=1.0, description="largest factor by which edges are exaggerated; 0: none"
    )
    resolution: Annotated[float, Field(ge=0.05, le=1, allow_inf_nan=False)] = Field(
        default=0.75, description="smallest factor on height and width, enlarged to the image's size again; 1: none"
    )
    quality: Annotated[int, Field(ge=1, le=LOSSLESS)] = Field(
        default=70, description=f"lowest quality of a JPEG file; {LOSSLESS}: none is made"
    )

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if 0 < self.iso < BASE_ISO:
            raise ValueError(f"iso: the lowest is {BASE_ISO}; 0 is for no noise")
        if replace(self.at([0.75] * DRAWS), direction=0.0) == PLAIN:
            raise ValueError("every setting is left out; give one of them a range, or leave out the sensor")
        return self

    def at(self, random: list[float]) -> Sensor:
        """The sensor at `DRAWS` numbers in [0,1]."""
        exposure, red, blue, defocus, motion, direction, iso, sharpening, resolution, quality = random
        return Sensor(
            exposure=self.exposure * (2 * exposure - 1),
            red=self.white_balance * (2 * red - 1),
            blue=self.white_balance * (2 * blue - 1),
            defocus=self.defocus * defocus,
            motion=self.motion * motion,
            direction=180 * direction,
            iso=BASE_ISO * 2 ** (iso * log2(self.iso / BASE_ISO)) if self.iso else 0.0,
            sharpening=self.sharpening * sharpening,
            resolution=1 - (1 - self.resolution) * resolution,
            quality=round(LOSSLESS - (LOSSLESS - self.quality) * quality),
        )


DRAWS = sum(map(len, GROUPS.values()))
"""Random numbers that a sensor takes."""
