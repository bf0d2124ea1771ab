"""From a resolved scene and a renderer's name to the renderer."""

from collections.abc import Sequence

from torch import Tensor

from services.rendering.color import as_saved
from services.rendering.image_renderer import ImageRenderer
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.plan import DEFAULT_TOLERANCE, Tolerance
from services.rendering.protocol import Renderer
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.scenes.resolve import ResolvedScene


def build(
    scene: ResolvedScene,
    renderer: str,
    picture: str | None = None,
    groups: Sequence[str] | None = None,
    tolerance: Tolerance = DEFAULT_TOLERANCE,
) -> Renderer:
    """The renderer `torch`, `pyrender` or `image`, compiled for attacks on `groups` (None: all) within `tolerance`.

    `picture` names the renderer that draws the picture of `image`.
    """
    if renderer == "image":
        drawn = build(scene, picture or "torch", tolerance="exact")
        return ImageRenderer(as_saved(drawn.render(_one(drawn)))[0], drawn.backend)
    if renderer == "torch":
        return TorchRenderer(scene, rasterise(scene), groups or TorchRenderer.groups, tolerance)
    if renderer == "pyrender":
        return PyrenderRenderer(scene, groups, tolerance)
    raise ValueError(f"no renderer {renderer!r}")


def _one(renderer: Renderer) -> dict[str, Tensor]:
    return {group: value[None] for group, value in renderer.initial().items()}
