"""Writes a scene as a binary glTF 2.0 file (.glb), and an asset as a scene of it alone.

The file has objects, camera, lights, and in `extras` what glTF has no words for. glTF has one kind of surface: one that
came with another, the Lambertian body under a coat, is written as the nearest that glTF has, a dielectric of the coat's
roughness, and `extras` name its own.
"""

import base64
import json
import struct
from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from scene_attack.analysis.images import png
from scene_attack.export.scene_values import LightValues, SceneValues, as_extras, scene_values
from scene_attack.rendering.pyrender.renderer import EXPOSURE
from scene_attack.scenes.description import Environment, Lights, Scene, SceneObject
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import Bytes, Doubles, MapName, MetallicRoughness, Part
from scene_attack.scenes.resolve import ResolvedScene, resolve, with_surface_of_part
from scene_attack.scenes.scene_file import DESCRIPTION, GENERATOR, THIS_FILE

_COMPONENTS = {np.dtype(np.float32): 5126, np.dtype(np.uint32): 5125}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
VERTICES, INDICES = 34962, 34963
"""OpenGL's targets of a buffer view."""
_LINEAR, _MIPMAPS = 9729, 9987
_JSON, _BIN = 0x4E4F534A, 0x004E4942


class Glb:
    """A file that is being made: lists of its JSON, which callers fill, and the bytes behind them.

    An array or image that is added twice is stored once.
    """

    def __init__(self, extras: Mapping[str, Any]) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": GENERATOR, "extras": dict(extras)},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
        }
        self._bytes = bytearray()
        self._made: dict[tuple[Any, ...], int] = {}
        self._derived: dict[int, NDArray[Any]] = {}
        self._alive: list[NDArray[Any]] = []
        """The arrays whose ids are keys: an id is another array's once its own is gone."""

    def add(self, what: str, entry: Mapping[str, Any]) -> int:
        """Appends an entry to the list `what` of the JSON ("nodes", "materials", …); returns its index there."""
        entries: list[dict[str, Any]] = self.json.setdefault(what, [])
        entries.append(dict(entry))
        return len(entries) - 1

    def uses(self, extension: str) -> None:
        """Notes that the file uses an extension that a reader may pass over."""
        used = self.json.setdefault("extensionsUsed", [])
        if extension not in used:
            used.append(extension)

    def kept(self, source: NDArray[Any], derive: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """The array that `derive` makes of `source`. It is made once and kept alive, so that it is stored once."""
        if id(source) not in self._derived:
            self._derived[id(source)] = derive()
            self._alive.append(source)
        return self._derived[id(source)]

    def accessor(self, values: NDArray[Any], target: int = VERTICES) -> int:
        """The accessor of an array of float32 or uint32, [n] or [n, 2 to 4]."""
        key = ("accessor", id(values))
        if key not in self._made:
            entry = {
                "bufferView": self._view(np.ascontiguousarray(values).tobytes(), target),
                "componentType": _COMPONENTS[values.dtype],
                "count": len(values),
                "type": _KINDS[values.shape[1] if values.ndim == 2 else 1],
            }
            if values.ndim == 2 and values.shape[1] == 3:  # required of positions
                entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
            self._made[key] = self.add("accessors", entry)
            self._alive.append(values)
        return self._made[key]

    def texture(self, texels: Bytes, wrap: tuple[int, int]) -> int:
        """The texture of texels uint8 [h, w, 4], row 0 at the top, repeated as OpenGL's modes `wrap` of u and v say.

        The image is a PNG file, without alpha where all texels are opaque.
        """
        key = ("texture", id(texels), wrap)
        if key not in self._made:
            image = ("image", id(texels))
            if image not in self._made:
                self._alive.append(texels)
                view = self._view(_png(texels), None)
                self._made[image] = self.add("images", {"bufferView": view, "mimeType": "image/png"})
            sampler = ("sampler", wrap)
            if sampler not in self._made:
                filters = {"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": wrap[0], "wrapT": wrap[1]}
                self._made[sampler] = self.add("samplers", filters)
            entry = {"source": self._made[image], "sampler": self._made[sampler]}
            self._made[key] = self.add("textures", entry)
        return self._made[key]

    def written(self) -> bytes:
        """The file."""
        if self._bytes:
            self.json["buffers"] = [{"byteLength": len(self._bytes)}]
        text = json.dumps(self.json, ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), _JSON) + text
        if self._bytes:
            chunks += struct.pack("<II", len(self._bytes), _BIN) + bytes(self._bytes)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _view(self, data: bytes, target: int | None) -> int:
        start = len(self._bytes)
        self._bytes += data + bytes(-len(data) % 4)
        entry = {"buffer": 0, "byteOffset": start, "byteLength": len(data)}
        return self.add("bufferViews", entry if target is None else entry | {"target": target})


def _png(texels: Bytes) -> bytes:
    opaque = bool((texels[..., 3] == 255).all())
    buffer = BytesIO()
    Image.fromarray(np.ascontiguousarray(texels[..., :3] if opaque else texels)).save(buffer, format="PNG")
    return buffer.getvalue()


COAT_ROUGHNESS = 0.45
"""The roughness of the coat in `shaders/radiance.frag`."""
COAT, GLTF, GLTF_SMITH = "coat", "gltf", "gltf-smith"
"""Values of a material's `extras.brdf`: the formula in `stock/mesh.frag` that gives the project's image."""


def primitive(glb: Glb, part: Part, factor: Doubles, exposure: float, name: str) -> dict[str, Any]:
    """The triangles of a part with its base colour times `factor` [3], linear RGB; emission times `exposure`."""
    own = part.metallic_roughness
    as_gltf = part if own is not None else with_surface_of_part(part, 0.0, COAT_ROUGHNESS)
    surface = as_gltf.metallic_roughness
    assert surface is not None
    brdf = COAT if own is None else GLTF_SMITH if own.given else GLTF
    attributes = {"POSITION": glb.accessor(part.vertices), "NORMAL": glb.accessor(part.normals)}
    if surface.maps and as_gltf.uv is not None:
        attributes["TEXCOORD_0"] = glb.accessor(_downwards(glb, as_gltf.uv))
    if any(texture.uv_set for texture in surface.maps.values()):
        attributes["TEXCOORD_1"] = glb.accessor(_downwards(glb, surface.second_uv))
    if "normal" in surface.maps:
        attributes["TANGENT"] = glb.accessor(surface.tangents)
    if not (surface.vertex_colors == 1).all():
        attributes["COLOR_0"] = glb.accessor(surface.vertex_colors)
    color = [*(factor * part.color[:3]).clip(0, 1).tolist(), float(part.color[3])]
    return {
        "attributes": attributes,
        "indices": glb.accessor(glb.kept(part.faces, lambda: part.faces.astype(np.uint32).ravel()), INDICES),
        "material": glb.add("materials", _material(glb, surface, color, exposure, brdf) | {"name": name}),
    }


def _downwards(glb: Glb, uv: Any) -> Any:
    """Texture coordinates [V, 2] with v downwards, as glTF has it."""
    return glb.kept(uv, lambda: np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype(np.float32))


def _material(glb: Glb, m: MetallicRoughness, color: list[float], exposure: float, brdf: str) -> dict[str, Any]:
    maps: dict[MapName, dict[str, Any]] = {
        name: {"index": glb.texture(texture.texels, texture.wrap), "texCoord": texture.uv_set}
        for name, texture in m.maps.items()
    }
    reflecting: dict[str, Any] = {
        "baseColorFactor": color,
        "metallicFactor": m.metallic,
        "roughnessFactor": m.roughness,
    }
    entry: dict[str, Any] = {
        "pbrMetallicRoughness": reflecting,
        "alphaMode": m.alpha_mode,
        "doubleSided": m.double_sided,
        "extras": {"brdf": brdf},
    }
    if m.alpha_mode == "MASK":
        entry["alphaCutoff"] = m.alpha_cutoff
    if "base_color" in maps:
        reflecting["baseColorTexture"] = maps["base_color"]
    if "metallic_roughness" in maps:
        reflecting["metallicRoughnessTexture"] = maps["metallic_roughness"]
    if "normal" in maps:
        entry["normalTexture"] = maps["normal"] | {"scale": m.normal_scale}
    if "occlusion" in maps:
        entry["occlusionTexture"] = maps["occlusion"] | {"strength": m.occlusion_strength}
    if "emissive" in maps:
        entry["emissiveTexture"] = maps["emissive"]
    emission = [exposure * channel for channel in m.emissive]
    if any(emission):
        strength = max(1.0, *emission)
        entry["emissiveFactor"] = [channel / strength for channel in emission]
        if strength > 1:
            glb.uses("KHR_materials_emissive_strength")
            entry["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
    return entry


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


def scene_glb(
    scene: ResolvedScene,
    values: SceneValues,
    lit_by_map: bool,
    environment: str | None = None,
    meshes_are_named: bool = True,
) -> bytes:
    """The file. With `lit_by_map` the lights are left out: the image's light is the environment map in the file
    `environment`, which glTF cannot hold. Without `meshes_are_named` the objects' meshes are others than those of the
    scene's names."""
    glb = Glb({"units": UNITS, "brdf": BRDFS, "credits": scene.credits(lit_by_map)})
    for placed, pose, color in zip(scene.placed, values.poses, values.colors, strict=True):
        parts = []
        for number, part in enumerate(placed.mesh.parts):
            name = f"{placed.name} part {number}"
            mesh = glb.add("meshes", {"name": name, "primitives": [primitive(glb, part, color, EXPOSURE, name)]})
            parts.append(glb.add("nodes", {"name": name, "mesh": mesh}))
        extras: dict[str, Any] = {"sha256": placed.mesh.sha256, "color": color.tolist()}
        if isinstance(placed.described, SceneObject):
            extras |= {"mesh": placed.described.mesh, "credit": placed.mesh.credit}
            extras["centimetres_per_unit"] = placed.mesh.centimetres
        _root(glb, {"name": placed.name, "matrix": _matrix(pose), "children": parts, "extras": extras})
    _camera(glb, scene, values.camera)
    if not lit_by_map:
        for light in values.lights:
            _light(glb, light)
    extras = _scene_extras(scene, values, lit_by_map, environment)
    described = values.description.model_dump(mode="json")
    if not meshes_are_named:
        described["objects"] = [thing | {"mesh": THIS_FILE} for thing in described["objects"]]
    glb.json["scenes"][0] |= {"name": "scene", "extras": extras | {DESCRIPTION: described}}
    return glb.written()


def _scene_extras(
    scene: ResolvedScene, values: SceneValues, lit_by_map: bool, environment: str | None
) -> dict[str, Any]:
    extras: dict[str, Any] = {
        "description_is": "the scene as a request has it: a request that has this file as its source gets it back",
        "size": list(scene.description.camera.size),
        "ground": list(scene.description.ground),
        "ground_is": "the displayed colour behind the objects, composited by coverage",
        "samples": "4 samples a pixel, averaged as radiance times coverage before the display curve",
    }
    if scene.description.background is not None:
        behind = scene.ground_from(scene.projection @ np.linalg.inv(values.camera))
        extras["background"] = base64.b64encode(png(torch.tensor(np.rint(behind * 255).astype(np.uint8)))).decode()
        extras["background_is"] = "what is behind the objects in place of the ground, a PNG file in base64"
    if lit_by_map:
        return extras | {
            "environment": environment,
            "light": "the environment map alone; the file has no light, and its materials are not the DSBRDFs of the "
            "image",
        }
    up = EXPOSURE * values.ambient
    return extras | {
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


def asset_glb(mesh: str, library: Library) -> bytes:
    """The binary glTF file of a mesh by its name in a scene. Raises InvalidRequest as `resolve` does."""
    lights = Lights(environment=Environment(map="uniform"))  # the file has no map, so none is read
    scene = resolve(Scene(objects=(SceneObject(mesh=mesh),), lights=lights), library)
    return scene_glb(scene, scene_values(scene, {}), lit_by_map=False)
