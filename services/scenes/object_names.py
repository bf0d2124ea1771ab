"""Names for the objects of a scene, as sentences and tables call them."""

from collections import Counter
from collections.abc import Mapping

from services.scenes.description import Scene


def object_names(scene: Scene, titles: Mapping[str, str]) -> list[str]:
    """A name for each object: its mesh's without the folder, or what people call it by `titles`; its number if the mesh
    has none or others share it.
    """
    names = [titles.get(thing.mesh, thing.mesh.rpartition("/")[2]) for thing in scene.objects]
    shared = Counter(names)
    plain = [not name.startswith("sha256:") and shared[name] == 1 for name in names]
    return [name if good else f"object {k}" for k, (name, good) in enumerate(zip(names, plain, strict=True))]
