"""Defines the protocol of renderers: a renderer turns named parameter groups into images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from scene_attack.rendering.plan import ImageError, Plan

Parameters = dict[str, Tensor]
"""Values by group name, on the CPU whatever the renderer's device. Scene values and perturbations have no batch
dimension; values to render have a leading batch dimension ([B, …])."""

BOUND_SLACK = 1e-5
"""Largest distance by which rounding may take a parameter out of its bounds, relative to 1 + |initial value|."""


@dataclass(frozen=True)
class InactiveCoordinate:
    """A coordinate of a group that changes no pixel: its group, flat index and name, and the reason."""

    group: str
    index: int
    name: str
    why: str


class Renderer(Protocol):
    """A scene, prepared for attacks on a set of groups. `DeclaredRenderer` (declaration) is a base class for it.

    `groups` is ordered and is the order used in tables. `backend` names everything that decides the bits of an image:
    library versions, GL platform and driver, dtype, threads. Rendering is deterministic: the same parameters give the
    same bits, whatever else is in the batch.
    """

    @property
    def name(self) -> str:
        """The renderer's name in a request."""
        ...

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the parameter groups, in the order in which tables list them."""
        ...

    @property
    def differentiable(self) -> bool:
        """Whether images are differentiable with respect to the parameters."""
        ...

    @property
    def backend(self) -> str:
        """A line that names everything that decides the bits of an image: versions, driver, dtype, threads."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the images, pixels."""
        ...

    @property
    def plan(self) -> Plan:
        """The plan: the steps of making an image, and the work that is left out."""
        ...

    def initial(self) -> Parameters:
        """Returns the scene's own values, {group: tensor}, without a batch dimension."""
        ...

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        """Returns the lowest and highest physically meaningful value of each group, broadcastable to it, or ±inf.

        Initial values are within them, and so must perturbed ones be: the loop refuses a method that leaves them.
        """
        ...

    def names(self, group: str) -> list[str] | None:
        """Returns a label for each coordinate of a small group ("point 0 energy"), in flat order; else None."""
        ...

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """Renders images [B, H, W, 3] as displayed, in [0,1], on the renderer's device.

        Groups that are left out keep their initial values; all others have the same batch size B.
        """
        ...

    def inactive(self, parameters: Mapping[str, Tensor], reach: Mapping[str, float]) -> Sequence[InactiveCoordinate]:
        """Returns coordinates proved to change no pixel.

        The proof holds at `parameters` {group: [...]} and wherever each group moves by at most its `reach`. A renderer
        that proves nothing returns none.
        """
        ...

    @property
    def sampled_error(self) -> ImageError | None:
        """The largest error of those of the images rendered so far that were also rendered exactly, as a check of the
        plan's estimate; None if there was none."""
        ...

    def exact(self) -> "Renderer":
        """Returns the exact renderer of the same scene, whose images decide verdicts.

        It takes no shortcut and computes in float64 where that matters. It may be the renderer itself.
        """
        ...

    def reseeded(self, number: int) -> "Renderer | None":
        """Returns the same renderer with other random numbers, those of `number` from 1; None if its images have no
        noise.
        """
        ...
