"""A perturbation in words of the scene: how many degrees, centimetres or percent something was changed by."""

from pydantic import BaseModel, ConfigDict, Field


class PhysicalChange(BaseModel):
    """The size of the change of one thing in the scene."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    group: str
    subject: str = Field(description='what was changed: "object 0", "point 0 energy", "map"')
    measure: str = Field(description='what is measured of it: "angle", "distance", "largest change"')
    value: float = Field(description="signed where it is a single number, else the size of the change")
    unit: str = Field(description='"degrees", "cm", "scene units", "%", or the unit that the group declares')
