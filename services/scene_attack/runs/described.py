"""The scene that a perturbation of the pyrender renderer's groups describes: the poses and colours of its objects and
the camera's place, which are fields of a scene. Renderers that have the same groups describe it, too.

Lights are left as they were: a question about a scene is not about them.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from scene_attack.rendering.pyrender.declaration import has_groups_of_pyrender
from scene_attack.scenes.description import Scene

if TYPE_CHECKING:
    from torch import Tensor

OF_OBJECTS = ("color", "translation", "rotation")
"""The groups that are fields of the scene's objects, by the fields' names."""
CAMERA = "camera"
"""The group of the camera's azimuth, elevation, distance and roll."""


def can_carry(renderer: str, groups: tuple[str, ...]) -> bool:
    """Whether a perturbation of these groups of the renderer changes fields of a scene."""
    return has_groups_of_pyrender(renderer) and any(group in (*OF_OBJECTS, CAMERA) for group in groups)


def described(scene: Scene, perturbation: "Mapping[str, Tensor]") -> Scene:
    """The scene with those groups of a perturbation in it that are its fields."""
    objects = []
    for index, placed in enumerate(scene.objects):
        changed = {}
        for group in OF_OBJECTS:
            if group in perturbation:
                change = perturbation[group][index].tolist()
                changed[group] = tuple(old + new for old, new in zip(getattr(placed, group), change, strict=True))
        objects.append(placed.model_copy(update=changed))
    camera = scene.camera
    if CAMERA in perturbation:
        fields = ("azimuth", "elevation", "distance", "roll")
        moves = zip(fields, perturbation[CAMERA].tolist(), strict=True)
        camera = camera.model_copy(update={field: getattr(camera, field) + moved for field, moved in moves})
    return scene.model_copy(update={"objects": tuple(objects), "camera": camera})
