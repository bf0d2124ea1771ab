"""Writes a scene as a binary glTF file: objects, camera, lights, and in `extras` what glTF has no words for."""

import base64
from typing import Any

import numpy as np
import torch

from services.analysis.images import png
from services.export.glb import Glb
from services.export.gltf_material import primitive
from services.export.scene_values import LightValues, SceneValues, as_extras
from services.rendering.pyrender_renderer.renderer import EXPOSURE
from services.scenes.mesh import Doubles
from services.scenes.resolve import ResolvedScene

LIGHTS = "KHR_lights_punctual"
UNITS = {
    "length": "scene units: an object of scale 1 fits the frame at a distance of 1.8; `centimetres_per_unit` of an "
    "object is the real length of a unit of its mesh, where it is known",
    "angle": "radians",
    "axes": "right-handed, +y up; the camera looks along its -z; lights shine along their -z",
    "light": "radiance times exposure is the linear value of the image; glTF's intensities have the exposure in them",
    "display": "linear values are clipped to [0,1] and shown by the sRGB curve (IEC 61966-2-1)",
}
BRDFS = {
    "coat": "a Lambertian body under a rough dielectric coat; glTF's roughness is the coat's, and the body keeps all "
    "its light, where glTF's loses what is reflected",
    "gltf": "glTF's metallic-roughness BRDF as pyrender has it, with Schlick's approximation of the shadowing",
    "gltf-smith": "glTF's metallic-roughness BRDF with Smith's height-correlated shadowing",
}


def scene_glb(scene: ResolvedScene, values: SceneValues, lit_by_map: bool, environment: str | None = None) -> bytes:
    """The file. With `lit_by_map` the lights are left out: the image's light is the environment map in the file
    `environment`, which glTF cannot hold."""
    glb = Glb({"units": UNITS, "brdf": BRDFS, "credits": scene.credits(lit_by_map)})
    for index, (placed, pose, color) in enumerate(zip(scene.placed, values.poses, values.colors, strict=True)):
        parts = []
        for number, part in enumerate(placed.mesh.parts):
            name = f"{placed.name} part {number}"
            mesh = glb.add("meshes", {"name": name, "primitives": [primitive(glb, part, color, EXPOSURE, name)]})
            parts.append(glb.add("nodes", {"name": name, "mesh": mesh}))
        extras: dict[str, Any] = {"sha256": placed.mesh.sha256, "color": color.tolist()}
        if index < len(scene.description.objects):
            extras |= {"mesh": scene.description.objects[index].mesh, "credit": placed.mesh.credit}
            extras["centimetres_per_unit"] = placed.mesh.centimetres
        _root(glb, {"name": placed.name, "matrix": _matrix(pose), "children": parts, "extras": extras})
    _camera(glb, scene, values.camera)
    if not lit_by_map:
        for light in values.lights:
            _light(glb, light)
    glb.json["scenes"][0] |= {"name": "scene", "extras": _scene_extras(scene, values, lit_by_map, environment)}
    return glb.written()


def _scene_extras(
    scene: ResolvedScene, values: SceneValues, lit_by_map: bool, environment: str | None
) -> dict[str, Any]:
    found: dict[str, Any] = {
        "size": list(scene.description.camera.size),
        "ground": list(scene.description.ground),
        "ground_is": "the displayed colour behind the objects, composited by coverage",
        "samples": "4 samples a pixel, averaged as radiance times coverage before the display curve",
    }
    if scene.description.background is not None:
        behind = scene.ground_from(scene.projection @ np.linalg.inv(values.camera))
        found["background"] = base64.b64encode(png(torch.tensor(np.rint(behind * 255).astype(np.uint8)))).decode()
        found["background_is"] = "what is behind the objects in place of the ground, a PNG file in base64"
    if lit_by_map:
        return found | {
            "environment": environment,
            "light": "the environment map alone; the file has no light, and its materials are not the DSBRDFs of the "
            "image",
        }
    up = EXPOSURE * values.ambient
    return found | {
        "exposure": EXPOSURE,
        "ambient": up,
        "ambient_is": "mean radiance from all around times the exposure; in direction w it is ambient (1 + w.y / 2), "
        "so a Lambertian surface of normal n reflects its base colour times ambient (1 + n.y / 3)",
        "shadows": None if scene.description.shadows is None else scene.description.shadows.model_dump(mode="json"),
    }


def _camera(glb: Glb, scene: ResolvedScene, pose: Doubles) -> None:
    camera, lens = scene.description.camera, scene.projection
    near, far = lens[2, 3] / (lens[2, 2] - 1), lens[2, 3] / (lens[2, 2] + 1)
    height, width = camera.size
    perspective = {"yfov": camera.field_of_view, "aspectRatio": width / height, "znear": near, "zfar": far}
    number = glb.add("cameras", {"type": "perspective", "perspective": perspective, "name": "camera"})
    _root(glb, {"name": "camera", "camera": number, "matrix": _matrix(pose)})


def _light(glb: Glb, light: LightValues) -> None:
    if light.kind != "point" and not np.any(light.direction):
        return  # an attack may shorten a direction to nothing, and such a light lights nothing
    glb.uses(LIGHTS)
    listed = glb.json.setdefault("extensions", {}).setdefault(LIGHTS, {"lights": []})["lights"]
    entry: dict[str, Any] = {
        "name": light.name,
        "type": light.kind,
        "color": [1.0, 1.0, 1.0],
        "intensity": EXPOSURE * float(light.energy),
        "extras": as_extras(light),
    }
    if light.kind == "spot":
        entry["spot"] = {"innerConeAngle": light.cone[0], "outerConeAngle": light.cone[1]}
    listed.append(entry)
    node = {"name": light.name, "matrix": _matrix(light.pose), "extensions": {LIGHTS: {"light": len(listed) - 1}}}
    _root(glb, node)


def _root(glb: Glb, node: dict[str, Any]) -> None:
    glb.json["scenes"][0]["nodes"].append(glb.add("nodes", node))


def _matrix(pose: Doubles) -> list[float]:
    """A matrix as glTF has it, column by column."""
    return [float(x) for x in pose.T.ravel()]
