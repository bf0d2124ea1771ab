"""Records of an attack: a row of its trace for each step, from which the dashboard draws its curves, and its cost.

This module does not import torch, so that the API can read it.
"""

from pydantic import BaseModel, ConfigDict, Field


class TraceRow(BaseModel):
    """The state at the start of a step, before its update; scores are those of the image rounded to 8 bits."""

    model_config = ConfigDict(extra="forbid")

    step: int
    restart: int = Field(0, description="number of the start that this step belongs to; the first is 0")
    loss: float = Field(description="probability of the labels to leave, or 1 minus that of the label to reach")
    label: str = Field(description="the network's answer: its most probable label")
    confidence: float = Field(description="probability of `label`")
    advantage: float = Field(
        description="largest log p of the labels to leave − largest other log p; targeted: largest other log p − log "
        "p_reach; with a least confidence c the larger of that and log(c / (1 − c)) − the new answer's log-odds; below "
        "0: the goal is met"
    )
    objective: float = Field(
        description="what the method minimises: the advantage, or for a method with gradients the log-odds of the "
        "label to leave or minus those of the label to reach, plus λ·distance²"
    )
    share: float | None = Field(
        None,
        description="with an expectation: share of the step's variations whose answer meets the goal; `objective` is "
        "then the mean over them and the scene itself, all else is of the scene itself; null without one",
    )
    distance: float = Field(description="‖ΔY‖₂ of the float image over all pixels and channels, RGB in [0,1]")
    perceptibility: float = Field(description="p(ΔY) of the float image")
    truncated: int = Field(description="pixels with a value truncated to U in this step")
    below_noise: int = Field(
        0,
        description="in the update before this row: differences below the noise (zoo), groups whose gradient is zero "
        "(fgsm)",
    )
    queries: int = Field(description="network queries so far, verification included")
    surrogate_queries: int = Field(0, description="images that the surrogate classified so far (p-rgf)")
    renders: int = Field(description="images rendered so far")
    seconds: float = Field(description="run time of the attack so far, over all attempts of the job")


class AttackCost(BaseModel):
    """The cost of an attack, over all attempts of its job; what only its report needs is not counted."""

    model_config = ConfigDict(extra="forbid")

    steps: int
    queries: int = Field(description="images that the target classified, verification included")
    surrogate_queries: int = Field(0, description="images that the surrogate classified, if the attack has one")
    renders: int
    truncated: int = Field(description="pixels that were truncated in at least one step")
    seconds: float
