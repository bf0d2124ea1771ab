"""A perturbation in words of the scene: changes in degrees, centimetres and percent."""

from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict, Field


class PhysicalChange(BaseModel):
    """The size of the change of one thing in the scene."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    group: str
    subject: str = Field(description='what was changed: "object 0", "point 0 energy", "map"')
    measure: str = Field(description='what is measured of it: "angle", "distance", "largest change"')
    value: float = Field(description="signed where it is a single number, else the size of the change")
    unit: str = Field(description='"degrees", "cm", "scene units", "%", or the unit that the group declares')


class ChangedValue(BaseModel):
    """A number of the scene before and after the attack."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(description='"object 0 translation x", "point 0 energy"')
    unit: str
    before: float
    after: float


class ChangeImage(BaseModel):
    """A file among a job's that shows a change."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    words: str


class Curve(BaseModel):
    """A quantity over an angle, before and after the attack."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    angles: list[float] = Field(description="degrees")
    before: list[float]
    after: list[float]


class Change(BaseModel):
    """What an attack did to one thing in the scene: a sentence, and the numbers behind it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    group: str
    subject: str = Field(description='what was changed: "piano", "lamp", "surface normals"')
    sentence: str = Field(description='"moved 4.2 cm right and 1.1 cm up"; what was changed is its grammatical subject')
    values: list[ChangedValue]
    images: list[ChangeImage] = Field(default_factory=list, description="images of it, among the job's files")
    curves: list[Curve] = Field(
        default_factory=list,
        description="of a material its reflectance, in 1/steradian, towards viewers in the plane of incidence of light "
        "at 45°, by the viewer's angle from the normal",
    )


def number(value: float) -> str:
    """A size with two significant digits, e.g. "4.2", "12", "0.0031" or "2e-06"."""
    return f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"


def signed(value: float) -> str:
    """A signed number as `number` writes it, with a minus that is as wide as a plus: "+3.1", "−14", "0"."""
    return ("+" if value > 0 else "−" if value < 0 else "") + number(abs(value))


def listed(parts: Sequence[str]) -> str:
    """Words joined by commas and a last "and"."""
    *others, last = parts
    return f"{', '.join(others)} and {last}" if others else last
