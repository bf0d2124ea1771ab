"""An asset as a glTF file: the scene of it alone, with the camera and the lights that a request leaves out."""

from services.export.scene_glb import scene_glb
from services.export.scene_values import scene_values
from services.scenes.description import Environment, Lights, Scene, SceneObject
from services.scenes.library import Library
from services.scenes.resolve import resolve


def asset_glb(mesh: str, library: Library) -> bytes:
    """The binary glTF file of a mesh by its name in a scene. Raises InvalidRequest as `resolve` does."""
    lights = Lights(environment=Environment(map="uniform"))  # the file has no map, so none is read
    scene = resolve(Scene(objects=(SceneObject(mesh=mesh),), lights=lights), library)
    return scene_glb(scene, scene_values(scene, {}), lit_by_map=False)
