"""The images before and after an attack, of a job of a service or of a folder that `run --out` or `attack` wrote."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from PIL.Image import Image

Loaded = TypeVar("Loaded")


class Images(Generic[Loaded]):
    """The images of a finished job, RGB of 8 bits; `numpy.asarray` makes an array [H, W, 3] of one."""

    def __init__(self, load: Callable[[str], Loaded]) -> None:
        self._load = load

    @property
    def original(self) -> Loaded:
        """The scene as it was."""
        return self._load("original.png")

    @property
    def attacked(self) -> Loaded:
        """The scene after the attack, as the network was asked about it."""
        return self._load("attacked.png")

    @property
    def perturbation(self) -> Loaded:
        """The difference of the two, times 5, plus 128."""
        return self._load("perturbation.png")


def images(folder: Path | str) -> Images[Image]:
    """The images in a folder of a finished job. Reading one raises FileNotFoundError if it is not there."""
    return Images(cache(lambda name: opened((Path(folder) / name).read_bytes())))


def opened(data: bytes) -> Image:
    """The RGB image in a PNG's bytes."""
    import PIL.Image

    return PIL.Image.open(io.BytesIO(data)).convert("RGB")
