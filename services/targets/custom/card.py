"""Defines the card of a network that a user brings: `card.json` in its folder. It needs no torch."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from services.targets.info import LONGEST_LABEL

Line = Annotated[str, Field(min_length=1, max_length=300)]
Label = Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)]
MAX_LABELS = 100_000
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


class Card(BaseModel):
    """What a model file does not say: the labels of the scores, how an image becomes the input, and where it is from.

    Exactly one of a model file in the folder, `factory` and `endpoint` says what computes the scores.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: Line | None = Field(None, description="a line for lists; default: the folder's name")
    labels: Annotated[tuple[Label, ...], Field(min_length=1, max_length=MAX_LABELS)] | Line = Field(
        description="the label of each score, in order: a list, the name of a text file in the folder with one label a "
        'line, or "imagenet" for the 1,000 classes of ImageNet-1k'
    )
    preprocessing: Preprocessing = Field(Preprocessing(), description="how an image becomes the network's input")
    output: Literal["scores", "probabilities"] = Field(
        "scores",
        description="what the network returns: scores before the softmax, or probabilities, of which the logarithm is "
        "taken",
    )
    licence: Line = Field("not stated", description="the licence of the weights")
    source: Line = Field("not stated", description="where the weights come from")
    architecture: Line | None = Field(
        None, description="for model.safetensors: the registered architecture whose weights these are"
    )
    factory: Line | None = Field(
        None,
        pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$",
        description="module:callable that returns the network; it must be among SCENE_ATTACK_TARGET_FACTORIES",
    )
    endpoint: Line | None = Field(
        None, description="URL that answers with scores; it must be among SCENE_ATTACK_TARGET_ENDPOINTS"
    )
