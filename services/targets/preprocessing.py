"""Describes how an image becomes a network's input. It needs no torch, so that the API can import it."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Pixels = Annotated[int, Field(ge=1, le=4096)]
Triple = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Preprocessing(BaseModel):
    """Turns an RGB image with values in [0,1] into the input: resize, (value − mean) / scale, order of channels."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    input_size: tuple[Pixels, Pixels] = Field((224, 224), description="height and width of the input, pixels")
    mean: Triple = Field((0.0, 0.0, 0.0), description="mean of red, green and blue, for values in [0,1]")
    scale: tuple[Positive, Positive, Positive] = Field(
        (1.0, 1.0, 1.0), description="divisor of red, green and blue (often called std), for values in [0,1]"
    )
    resize: Literal["bilinear", "bicubic"] = Field(
        "bilinear", description="interpolation, antialiased, where an image has another size"
    )
    channels: Literal["rgb", "bgr"] = Field("rgb", description="order of the input's channels")
