"""Items of a torch renderer's plan that concern the scene as a whole."""

from collections.abc import Iterator

from services.rendering.plan import Item
from services.rendering.torch_renderer.visible_surfaces import VisibleSurfaces
from services.scenes.resolve import ResolvedScene


def ignored_items(scene: ResolvedScene) -> Iterator[Item]:
    """Yields items on what the scene says of its surfaces and the renderer does not use."""
    why = "metallic, roughness, emission and occlusion are ignored: the torch renderer has materials of its own"
    parts = [part for placed in scene.placed if not placed.given_surface for part in placed.mesh.parts]
    if own := sum(part.metallic_roughness is not None for part in parts):
        yield Item(what="materials of the file", kept=0, of=own, why=why)
    if given := sum(placed.given_surface for placed in scene.placed):
        why = "the fields are pyrender's: the torch renderer has materials of its own, named in `material`"
        yield Item(what="metallic and roughness", kept=0, of=given, why=why)


def surface_items(visible: VisibleSurfaces) -> Iterator[Item]:
    """Yields the item on pixels that show several surfaces."""
    if visible.turns is not None:
        count = len(visible.angles)
        why = (
            "in a pixel at an outline each surface is shaded by itself, and their colours are averaged by their shares"
        )
        yield Item(what="surfaces of pixels", kept=count, of=count, why=why)
