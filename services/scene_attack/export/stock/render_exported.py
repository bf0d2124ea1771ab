"""Draws an exported scene with trimesh and pyrender, at the camera and lights in the file. It needs nothing else.

    pip install trimesh pyrender-maintained pillow
    python render_exported.py scene_after.glb rendered.png
    python render_exported.py scene_after.glb rendered.png --compare attacked.png

trimesh reads the geometry, the poses and the textures. What it does not keep is read from the file's JSON: the camera,
the lights (KHR_lights_punctual), exact factors, tangents, and `extras`. pyrender draws, with the two shaders beside
this file in place of its own: glTF and pyrender know no light that is brighter above, no coat and no sRGB curve. What
is drawn is read as floats, with pyrender's own 4 samples a pixel, and shown as `extras` of the scene says.

Off screen it draws by EGL; PYOPENGL_PLATFORM=osmesa draws without a graphics driver.
"""

import argparse
import base64
import json
import os
import struct
import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
os.environ.setdefault("PYGLET_HEADLESS", "true")  # else pyrender's viewer looks for X11's libraries

import numpy as np
import pyrender
import trimesh
from numpy.typing import NDArray
from OpenGL import GL
from PIL import Image
from pyrender.renderer import Renderer
from pyrender.shader_program import ShaderProgramCache

BRDFS = {"coat": 0, "gltf": 1, "gltf-smith": 2}
MAPS = {
    "baseColorTexture": "base_color_uv",
    "metallicRoughnessTexture": "metallic_roughness_uv",
    "normalTexture": "normal_uv",
    "occlusionTexture": "occlusion_uv",
    "emissiveTexture": "emissive_uv",
}
SRGB = ("baseColorTexture", "emissiveTexture")
Floats = NDArray[np.float32]


class Texture(pyrender.Texture):  # type: ignore[misc]
    """A texture with mipmaps, decoded from sRGB before it is filtered where it is a colour."""

    srgb, wrap = False, (GL.GL_REPEAT, GL.GL_REPEAT)

    def _add_to_context(self) -> None:
        height, width = self.source.shape[:2]
        self._texid = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
        kind = GL.GL_SRGB8_ALPHA8 if self.srgb else GL.GL_RGBA8
        rows = np.ascontiguousarray(self.source[::-1])  # OpenGL's first row is the bottom one
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, kind, width, height, 0, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, rows)
        GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_S, self.wrap[0])
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_T, self.wrap[1])


class FloatRenderer(Renderer):  # type: ignore[misc]
    """Pyrender's renderer with a framebuffer of floats, our shaders, and their uniforms."""

    coverage_only = 0

    def _configure_main_framebuffer(self) -> None:
        super()._configure_main_framebuffer()
        size = (self.viewport_width, self.viewport_height)
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, self._main_cb)
        GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, GL.GL_RGBA32F, *size)
        GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, self._main_cb_ms)
        GL.glRenderbufferStorageMultisample(GL.GL_RENDERBUFFER, 4, GL.GL_RGBA32F, *size)

    def _read_main_framebuffer(self, scene: Any, flags: int) -> Floats:  # noqa: ARG002 - pyrender's
        width, height = self._main_fb_dims
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb_ms)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self._main_fb)
        whole = (0, 0, width, height)
        GL.glBlitFramebuffer(*whole, *whole, GL.GL_COLOR_BUFFER_BIT, GL.GL_NEAREST)
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._main_fb)
        read = GL.glReadPixels(*whole, GL.GL_RGBA, GL.GL_FLOAT)
        return np.frombuffer(read, np.float32).reshape(height, width, 4)[::-1]

    def _get_camera_matrices(self, scene: Any) -> Any:
        view, lens = super()._get_camera_matrices(scene)
        self._clip_from_world = lens @ view
        return view, lens

    def _bind_and_draw_primitive(self, primitive: Any, pose: Any, program: Any, flags: int) -> None:
        uniforms = primitive.uniforms | {
            "clip_from_mesh": self._clip_from_world @ pose,
            "normal_from_mesh": np.linalg.inv(pose[:3, :3]).T,
            "coverage_only": self.coverage_only,
        }
        for name, value in uniforms.items():
            program.set_uniform(name, value)
        GL.glDepthMask(GL.GL_FALSE if uniforms["blended"] else GL.GL_TRUE)
        super()._bind_and_draw_primitive(primitive, pose, program, flags)
        GL.glDepthMask(GL.GL_TRUE)


def read_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk of a .glb file."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def floats(head: dict[str, Any], chunk: bytes, number: int, width: int) -> Floats:
    """The values [n, width] of an accessor of float32."""
    accessor = head["accessors"][number]
    start = head["bufferViews"][accessor["bufferView"]]["byteOffset"]
    return np.frombuffer(chunk, np.float32, accessor["count"] * width, start).reshape(-1, width)


def primitive_of(head: dict[str, Any], chunk: bytes, mesh: Any, entry: dict[str, Any]) -> pyrender.Primitive:
    """The pyrender primitive of a trimesh mesh and of its entry in the file."""
    material = head["materials"][entry["material"]]
    reflecting, read = material["pbrMetallicRoughness"], mesh.visual.material
    strength = material.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    uniforms: dict[str, Any] = {
        "brdf": BRDFS[material["extras"]["brdf"]],
        "blended": int(material["alphaMode"] == "BLEND"),
        "alpha_cutoff": float(material.get("alphaCutoff", 0.5)) if material["alphaMode"] == "MASK" else -1.0,
        "normal_scale": float(material.get("normalTexture", {}).get("scale", 1.0)),
        "occlusion_strength": float(material.get("occlusionTexture", {}).get("strength", 1.0)),
    }
    maps = {}
    for name, uniform in MAPS.items():
        used = reflecting.get(name) or material.get(name)
        if used is not None:
            wrap = head["samplers"][head["textures"][used["index"]]["sampler"]]
            texels = np.array(getattr(read, name).convert("RGBA"))
            maps[name] = Texture(source=texels, source_channels="RGBA")
            maps[name].srgb, maps[name].wrap = name in SRGB, (wrap["wrapS"], wrap["wrapT"])
            uniforms[uniform] = used["texCoord"]
    attributes = entry["attributes"]
    second = floats(head, chunk, attributes["TEXCOORD_1"], 2) if "TEXCOORD_1" in attributes else None
    primitive = pyrender.Primitive(
        positions=mesh.vertices,
        normals=mesh.vertex_normals,
        tangents=floats(head, chunk, attributes["TANGENT"], 4) if "TANGENT" in attributes else None,
        texcoord_0=mesh.visual.uv,
        texcoord_1=None if second is None else second * (1, -1) + (0, 1),  # OpenGL's v grows upwards
        color_0=floats(head, chunk, attributes["COLOR_0"], 4) if "COLOR_0" in attributes else None,
        indices=mesh.faces,
        material=pyrender.MetallicRoughnessMaterial(
            baseColorFactor=reflecting["baseColorFactor"],
            metallicFactor=reflecting["metallicFactor"],
            roughnessFactor=reflecting["roughnessFactor"],
            emissiveFactor=strength * np.array(material.get("emissiveFactor", (0.0, 0.0, 0.0))),
            alphaMode="BLEND" if uniforms["blended"] else "OPAQUE",
            doubleSided=material["doubleSided"],
            **maps,
        ),
    )
    primitive.uniforms = uniforms
    return primitive


def scene_of(path: Path) -> tuple[pyrender.Scene, dict[str, Any]]:
    """The pyrender scene of a file, and the `extras` of the file's scene."""
    head, chunk = read_glb(path)
    extras = head["scenes"][0]["extras"]
    if "ambient" not in extras:
        sys.exit(f"{path}: its light is {extras['light']}")
    read = trimesh.load_scene(path)
    entries = {mesh["name"]: mesh["primitives"][0] for mesh in head["meshes"]}
    scene = pyrender.Scene(bg_color=(0, 0, 0, 0), ambient_light=np.full(3, extras["ambient"]))
    names = set(read.graph.nodes_geometry)
    for node in head["nodes"]:
        parts = [head["nodes"][k]["name"] for k in node.get("children", ())]
        solid: list[pyrender.Primitive] = []
        blended: list[pyrender.Primitive] = []
        for part in (name for name in parts if name in names):
            pose, geometry = read.graph[part]
            primitive = primitive_of(head, chunk, read.geometry[geometry], entries[geometry])
            (blended if primitive.uniforms["blended"] else solid).append(primitive)
        # Solid parts together, so that they are drawn in the file's order; blended ones each by its own distance.
        for group in ([solid] if solid else []) + [[primitive] for primitive in blended]:
            scene.add(pyrender.Mesh(primitives=group), pose=pose)
    for thing, pose in light_and_camera(head):
        scene.add(thing, pose=pose)
    return scene, extras


def light_and_camera(head: dict[str, Any]) -> Iterator[tuple[Any, NDArray[np.float64]]]:
    """The camera and the lights of a file, which trimesh does not keep, each with its pose [4, 4]."""
    lights = head.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    for node in head["nodes"]:
        pose = np.array(node.get("matrix", np.eye(4))).reshape(4, 4).T
        if "camera" in node:
            lens = head["cameras"][node["camera"]]["perspective"]
            camera = {"aspectRatio": lens["aspectRatio"], "znear": lens["znear"], "zfar": lens["zfar"]}
            yield pyrender.PerspectiveCamera(yfov=lens["yfov"], **camera), pose
        if "extensions" in node:
            yield light_of(lights[node["extensions"]["KHR_lights_punctual"]["light"]]), pose


def light_of(light: dict[str, Any]) -> pyrender.Light:
    """The pyrender light of a light of KHR_lights_punctual; pyrender's intensities are glTF's numbers."""
    intensity = light["intensity"]
    if light["type"] == "point":
        return pyrender.PointLight(color=light["color"], intensity=intensity)
    if light["type"] == "directional":
        return pyrender.DirectionalLight(color=light["color"], intensity=intensity)
    cone = light["spot"]
    angles = {"innerConeAngle": cone["innerConeAngle"], "outerConeAngle": cone["outerConeAngle"]}
    return pyrender.SpotLight(color=light["color"], intensity=intensity, **angles)


def ground_of(extras: dict[str, Any]) -> NDArray[np.float64]:
    """The displayed values behind the objects: one colour [3], or an image [H, W, 3]."""
    if "background" not in extras:
        return np.array(extras["ground"])
    return np.asarray(Image.open(BytesIO(base64.b64decode(extras["background"]))).convert("RGB")) / 255


def rendered(path: Path) -> NDArray[np.uint8]:
    """The image uint8 [H, W, 3] of a file."""
    scene, extras = scene_of(path)
    height, width = extras["size"]
    off_screen = pyrender.OffscreenRenderer(width, height)
    off_screen._platform.make_current()
    drawing = FloatRenderer(width, height)
    drawing._program_cache = ShaderProgramCache(shader_dir=str(Path(__file__).parent))
    flags = pyrender.RenderFlags.OFFSCREEN
    radiance = drawing.render(scene, flags)[..., :3].astype(np.float64)
    drawing.coverage_only = 1  # what alpha cannot say: pyrender squares the opacity of what it blends
    coverage = drawing.render(scene, flags)[..., :1].astype(np.float64)
    linear = (radiance / np.maximum(coverage, 1e-6)).clip(0, 1)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    image = shown * coverage + ground_of(extras) * (1 - coverage)
    levels: NDArray[np.uint8] = np.rint(image.clip(0, 1) * 255).astype(np.uint8)
    return levels


def main() -> int:
    """Draws a file, and says how much of it is another image's within 1/255."""
    parser = argparse.ArgumentParser(description="Draw an exported scene with trimesh and pyrender.")
    parser.add_argument("scene", type=Path, help="scene_before.glb or scene_after.glb")
    parser.add_argument("image", type=Path, help="the PNG file to write")
    parser.add_argument("--compare", type=Path, help="an image of the same size")
    asked = parser.parse_args()
    image = rendered(asked.scene)
    Image.fromarray(image).save(asked.image)
    if asked.compare is not None:
        other = np.asarray(Image.open(asked.compare).convert("RGB")).astype(int)
        difference = np.abs(image.astype(int) - other).max(axis=-1)
        print(f"{(difference <= 1).mean():.4%} of the pixels within 1/255, {(difference == 0).mean():.4%} equal")
    return 0


if __name__ == "__main__":
    sys.exit(main())
