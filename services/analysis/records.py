"""What the analysis says, as records: nothing of torch is needed to read them."""

from pydantic import BaseModel, ConfigDict, Field


class Answer(BaseModel):
    """The network's answer to one image, as saved (8 bits)."""

    model_config = ConfigDict(extra="forbid")

    label: str
    index: int
    confidence: float = Field(description="probability of `label`")
    goal_probability: float = Field(description="probability of the goal's label (the one to leave, or to reach)")
    top: list[tuple[str, float]] = Field(description="the five most probable labels")


class Subset(BaseModel):
    """The found perturbation with only some groups applied, rendered exactly."""

    model_config = ConfigDict(extra="forbid")

    groups: list[str]
    label: str
    confidence: float
    goal_probability: float
    perceptibility: float
    fooled: bool
