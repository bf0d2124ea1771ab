"""The one protocol everything else is generic over: a renderer turns named parameter groups into images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from services.rendering.image_error import ImageError
from services.rendering.plan import Plan

Parameters = dict[str, Tensor]
"""Group name to values. Without a batch dimension for a state or a perturbation, with one ([B, …]) to render.
On the CPU, wherever images are made."""


@dataclass(frozen=True)
class InactiveCoordinate:
    """A coordinate of a group, by its flat index, that changes no pixel; its name, and why."""

    group: str
    index: int
    name: str
    why: str


class Renderer(Protocol):
    """A scene, compiled for one set of groups. `services.rendering.declaration.DeclaredRenderer` is a base for it.

    `groups` is ordered and is the order used in tables. `backend` names everything that decides the bits of an image:
    library versions, GL platform and driver, dtype, threads. Rendering is deterministic: the same parameters give the
    same bits, whatever else is in the batch.
    """

    @property
    def name(self) -> str:
        """The word of the request."""
        ...

    @property
    def groups(self) -> tuple[str, ...]:
        """Parameter groups, in the order of every table."""
        ...

    @property
    def differentiable(self) -> bool:
        """Whether gradients reach the input."""
        ...

    @property
    def backend(self) -> str:
        """Everything that decides the bits of the output: versions, driver, dtype, threads."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images."""
        ...

    @property
    def plan(self) -> Plan:
        """What it does for an image, and what it leaves out."""
        ...

    def initial(self) -> Parameters:
        """The scene's own values, {group: tensor}, without a batch dimension."""
        ...

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        """Lowest and highest physically meaningful value of each group, broadcastable to it; ±inf where unbounded."""
        ...

    def names(self, group: str) -> list[str] | None:
        """A word for each coordinate of a small group ("point 0 energy"), in flat order; None for image-like groups."""
        ...

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Images [B, H, W, 3] in [0,1], as displayed, on the renderer's device. Groups left out keep their initial
        values; B is shared by all."""
        ...

    def inactive(self, parameters: Mapping[str, Tensor], reach: Mapping[str, float]) -> Sequence[InactiveCoordinate]:
        """Coordinates proved to change no pixel at `parameters` {group: [...]}, moved by at most the group's `reach`.

        A renderer that proves nothing returns none.
        """
        ...

    @property
    def sampled_error(self) -> ImageError | None:
        """The largest error of those of the images rendered so far that were also rendered exactly, as a check of the
        plan's estimate; None if there was none."""
        ...

    def exact(self) -> "Renderer":
        """The twin that judges: no shortcut, float64 where that matters. May be the renderer itself."""
        ...
