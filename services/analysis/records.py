"""Records of the analysis. This module does not import torch, so that the API can read them."""

from pydantic import BaseModel, ConfigDict, Field


class Answer(BaseModel):
    """The network's answer to one image, rounded to 8 bits."""

    model_config = ConfigDict(extra="forbid")

    label: str
    index: int
    confidence: float = Field(description="probability of `label`")
    goal_probability: float = Field(
        description="probability of the goal's labels together (those to leave, or the one to reach)"
    )
    top: list[tuple[str, float]] = Field(description="the five most probable labels")


class Subset(BaseModel):
    """The network's answer to the stored perturbation with only some of its groups applied, rendered exactly."""

    model_config = ConfigDict(extra="forbid")

    groups: list[str]
    label: str
    confidence: float
    goal_probability: float
    perceptibility: float
    fooled: bool
