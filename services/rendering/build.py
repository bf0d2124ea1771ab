"""From a resolved scene and a renderer's name to the renderer."""

from torch import Tensor

from services.rendering.display import as_saved
from services.rendering.gbuffer import rasterise
from services.rendering.image_renderer import ImageRenderer
from services.rendering.protocol import Renderer
from services.rendering.pyrender_renderer import PyrenderRenderer
from services.rendering.torch_renderer import TorchRenderer
from services.scenes.resolve import ResolvedScene


def build(scene: ResolvedScene, renderer: str, picture: str | None = None) -> Renderer:
    """The renderer `torch`, `pyrender` or `image`; `picture` names the renderer that draws the picture of `image`."""
    if renderer == "image":
        drawn = build(scene, picture or "torch").exact()
        return ImageRenderer(as_saved(drawn.render(_one(drawn)))[0], drawn.backend)
    if renderer == "torch":
        return TorchRenderer(scene, rasterise(scene))
    if renderer == "pyrender":
        return PyrenderRenderer(scene)
    raise ValueError(f"no renderer {renderer!r}")


def _one(renderer: Renderer) -> dict[str, Tensor]:
    return {group: value[None] for group, value in renderer.initial().items()}
