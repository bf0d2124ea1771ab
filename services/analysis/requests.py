"""What a request may ask to be analysed beyond what every result has. This module does not import torch."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from services.names import reference
from services.scenes.description import Model

Name = Annotated[str, Field(min_length=1, max_length=100)]
Steps = Annotated[int, Field(ge=1, le=10_000)]


By = Literal["coordinate", "object"]


def _by_coordinate(value: object) -> bool:
    return value == "coordinate"


class CoordinatesRequest(Model):
    """Shapley values of single coordinates; groups without named coordinates (pixels, texels) count as a whole."""

    by: By = Field(
        "coordinate",
        exclude_if=_by_coordinate,
        description="`object`: a part is all of a group that belongs to one object or light, such as `object 2 color`",
    )

    images: Annotated[int, Field(ge=4, le=1_000_000)] = Field(
        4096,
        description="largest number of images: enough for exact values of 12 coordinates; with more coordinates, or "
        "fewer images, values are means over random orders, with standard errors",
    )


class MinimalRequest(Model):
    """The smallest scale of the stored perturbation that still fools the network."""

    scans: Annotated[int, Field(ge=1, le=1000)] = Field(16, description="evenly spaced scales that are tried first")
    bisections: Annotated[int, Field(ge=0, le=30)] = Field(
        8, description="halvings of the interval below the first scale that fools"
    )


class TransferRequest(Model):
    """The stored perturbation before other networks, and in the other renderer."""

    targets: Annotated[tuple[Annotated[Name, reference("target")], ...], Field(max_length=16)] = Field(
        (), description="targets to show the image to"
    )
    renderers: Annotated[tuple[Name, ...], Field(max_length=4)] = Field(
        (), description="renderers to draw the changed scene with, as far as the perturbation changes the scene itself"
    )

    @model_validator(mode="after")
    def _something(self) -> "TransferRequest":
        if not self.targets and not self.renderers:
            raise ValueError("name a target in `targets` or a renderer in `renderers`")
        return self


class InterpretationRequest(Model):
    """Fits of normals, illumination and material to the attacked image: 3 learning rates times 2 optimisers."""

    steps: Steps = Field(100, description="steps of each of the six fits")


class RerenderingRequest(Model):
    """The re-rendering defence: one fit of normals, illumination and material, and the answer to its rendering."""

    optimiser: Literal["sgd", "adam"] = Field("adam", description="the optimiser of the fit")
    rate: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] = Field(
        1e-3, description="its learning rate, in the units of each group"
    )
    steps: Steps = Field(100, description="its number of steps")


class AdaptiveRequest(Model):
    """An attack on the original image's pixels that knows the re-rendering defence; each step needs a fit."""

    steps: Annotated[int, Field(ge=1, le=1000)] = Field(10, description="largest number of steps")
    fit: RerenderingRequest = Field(RerenderingRequest(steps=30), description="the defence that it attacks")


class AnalysisRequest(Model):
    """The analyses of the stored perturbation to make after the attack. Each is left out unless it is named; {} gives
    its defaults. Perceptibility, the table of subsets and the groups' Shapley values are in every result.
    """

    coordinates: CoordinatesRequest | None = Field(None, description="Shapley values of single coordinates")
    minimal: MinimalRequest | None = Field(None, description="the smallest scale that still fools")
    transfer: TransferRequest | None = Field(None, description="other targets and renderers")
    interpretation: InterpretationRequest | None = Field(None, description="fits of physical parameters to the image")
    rerendering: RerenderingRequest | None = Field(None, description="the re-rendering defence")
    adaptive: AdaptiveRequest | None = Field(None, description="an attack through the re-rendering defence")
