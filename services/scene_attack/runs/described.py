"""The scene that a perturbation of physical parameters describes, so that another renderer can draw it.

Only the pyrender renderer's parameters, which others may have too, are fields of a scene: poses and colours of objects
and the camera's place, which every renderer draws.
Its lights are its own; the torch renderer is lit by the environment map. The torch renderer's normals belong to the
pixels of one view, and its texels and material coefficients to itself. The pixels of an image belong to no scene.
"""

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.pyrender.declaration import has_groups_of_pyrender
from scene_attack.scenes.description import Scene

OF_OBJECTS = ("color", "translation", "rotation")
"""The pyrender renderer's groups that are fields of the scene's objects, by the fields' names."""
CAMERA = "camera"
"""Its group of the camera's azimuth, elevation, distance and roll."""


def can_carry(renderer: str, groups: tuple[str, ...]) -> bool:
    """Whether a perturbation of these groups changes the scene that other renderers draw."""
    return has_groups_of_pyrender(renderer) and any(group in (*OF_OBJECTS, CAMERA) for group in groups)


def described(scene: Scene, renderer: str, perturbation: Parameters) -> tuple[Scene, list[str], list[str]]:
    """The scene with the perturbation in it, the groups that it carries, and those that it leaves out.

    Raises InvalidRequest("analysis.transfer.renderers") if it carries none.
    """
    if not can_carry(renderer, tuple(perturbation)):
        raise InvalidRequest("analysis.transfer.renderers", "no attacked group is a part of the scene itself")
    of_objects = [group for group in perturbation if group in OF_OBJECTS]
    objects = []
    for index, placed in enumerate(scene.objects):
        changed = {}
        for group in of_objects:
            change = perturbation[group][index].tolist()
            changed[group] = tuple(old + new for old, new in zip(getattr(placed, group), change, strict=True))
        objects.append(placed.model_copy(update=changed))
    camera, left = scene.camera, [group for group in perturbation if group not in (*OF_OBJECTS, CAMERA)]
    if CAMERA in perturbation:
        azimuth, elevation, distance, roll = perturbation[CAMERA].tolist()
        place = {
            "azimuth": camera.azimuth + azimuth,
            "elevation": camera.elevation + elevation,
            "distance": camera.distance + distance,
            "roll": camera.roll + roll,
        }
        camera = camera.model_copy(update=place)
    carried = [group for group in perturbation if group in (*OF_OBJECTS, CAMERA)]
    return scene.model_copy(update={"objects": tuple(objects), "camera": camera}), carried, left
