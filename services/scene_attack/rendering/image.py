"""The renderer whose parameters are the pixels of a fixed image: with it any attack method is an image-space attack."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from scene_attack.rendering.declaration import IMAGE_OF, BuildRequest, Declaration, DeclaredRenderer, Group, register
from scene_attack.rendering.plan import Item, Plan

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.rendering.protocol import Parameters


@register(
    Declaration(
        name="image",
        groups=(
            Group(
                name="image",
                shape=("H", "W", "3"),
                unit="displayed RGB value in [0,1]",
                words="pixels",
                explanation="three free values for every pixel: a change of the image, not of a thing in the scene",
                suggested_step=0.002,
                suggested_limit=8 / 255,
            ),
        ),
        differentiable=True,
        method="fgsm",
        explanation="changes the pixels of an image, and nothing in the scene",
        base_renderer="torch",
    )
)
class ImageRenderer(DeclaredRenderer):
    """A renderer whose images are its parameters.

    `image` is [H, W, 3] in [0,1]; `drawn_by` is the backend of the renderer that made it.
    """

    def __init__(self, image: "Tensor", drawn_by: str) -> None:
        self._image = image.float()
        self.size = (int(image.shape[0]), int(image.shape[1]))
        self.backend = f"{IMAGE_OF}{drawn_by}"
        height, width = self.size
        pixels = Item(what="pixels", kept=height * width, of=height * width, why="each is a parameter")
        self.plan = Plan.of(self.name, self.groups, self.size, "exact", [pixels])

    @classmethod
    def build(cls, request: BuildRequest) -> "ImageRenderer":
        """Makes the renderer of the base renderer's image, rounded to 8 bits."""
        assert request.base is not None
        return cls(request.base_image(), request.base.backend)

    def initial(self) -> "Parameters":
        """Returns the image, {"image": [H, W, 3]}."""
        return {"image": self._image.cpu().clone()}

    def bounds(self) -> "Mapping[str, tuple[Tensor, Tensor]]":
        """Returns 0 and 1, the bounds of a pixel."""
        image = self._image.cpu()
        return {"image": (image.new_tensor(0.0), image.new_tensor(1.0))}

    def render(self, parameters: "Mapping[str, Tensor]") -> "Tensor":
        """Returns the pixels [B, H, W, 3], clipped to [0,1], on the device of the base renderer."""
        return parameters["image"].to(self._image.device).clamp(0.0, 1.0)

    def exact(self) -> "ImageRenderer":
        """Returns itself: nothing is approximated."""
        return self
