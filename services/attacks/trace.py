"""One row per step of an attack: what the curves are drawn from."""

from pydantic import AliasChoices, BaseModel, ConfigDict, Field


class TraceRow(BaseModel):
    """The state at the start of a step, before its update; scores are those of the image as saved (8 bits)."""

    model_config = ConfigDict(extra="forbid")

    step: int
    loss: float = Field(description="probability of the label to leave, or 1 minus that of the label to reach")
    label: str = Field(description="first answer")
    confidence: float = Field(description="probability of the first answer")
    advantage: float = Field(description="log p_leave − max other log p, <0 is fooled (targeted: sign turned)")
    distance: float = Field(description="‖ΔY‖₂ of the float image over all pixels and channels, RGB in [0,1]")
    perceptibility: float = Field(description="p(ΔY) of the float image")
    truncated: int = Field(description="pixels held back by U in this step")
    below_noise: int = Field(
        0,
        validation_alias=AliasChoices("below_noise", "flat"),  # the latter in version 0.1
        description="in the update before this row: differences below the noise (zoo), groups whose gradient is zero "
        "(fgsm)",
    )
    queries: int = Field(description="network queries so far, verification included")
    renders: int = Field(description="images rendered so far")
    seconds: float = Field(description="since the attack began, over all attempts of the job")
