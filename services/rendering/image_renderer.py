"""The renderer whose parameters are the pixels of a fixed picture: image-space attacks are then nothing special."""

from collections.abc import Mapping

import torch
from torch import Tensor

from services.rendering.plan import Item, Plan
from services.rendering.protocol import Parameters


class ImageRenderer:
    """Shows a picture. `picture` [H, W, 3] in [0,1], taken as it would be saved; `drawn_by` names its backend."""

    name = "image"
    groups = ("image",)
    differentiable = True

    def __init__(self, picture: Tensor, drawn_by: str) -> None:
        self._picture = picture.to(torch.float32)
        self.size = (int(picture.shape[0]), int(picture.shape[1]))
        self.backend = f"image of {drawn_by}"
        height, width = self.size
        pixels = Item(what="pixels", kept=height * width, of=height * width, why="each is a parameter")
        self.plan = Plan.of(self.name, self.groups, self.size, "exact", [pixels])

    def initial(self) -> Parameters:
        """The picture, {"image": [H, W, 3]}."""
        return {"image": self._picture.clone()}

    def bounds(self) -> Mapping[str, tuple[Tensor, Tensor]]:
        """Pixels are in [0,1]."""
        return {"image": (torch.tensor(0.0), torch.tensor(1.0))}

    def names(self, group: str) -> list[str] | None:  # noqa: ARG002 - the protocol's
        """None: pixels have no names."""
        return None

    def render(self, parameters: Mapping[str, Tensor]) -> Tensor:
        """The pixels [B, H, W, 3], clipped to [0,1]."""
        return parameters["image"].clamp(0.0, 1.0)

    def exact(self) -> "ImageRenderer":
        """Itself: nothing is approximated."""
        return self
