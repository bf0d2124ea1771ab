"""The process that Blender runs in: `python -m scene_attack_blender.cycles <socket> <folder>`. It reads a scene and
then frames of it from the socket, which is given as a file descriptor, and writes their images to it.

A message is a line of JSON and the bytes of the arrays that its `arrays` lists as [name, number of bytes]. A scene is
sent first (`Stage`), then frames of it (`Stage.render`); another scene may follow. A frame is answered by a line
{"bytes": n} and n bytes: float32 [H, W, 4], the bottom row first, linear radiance times coverage, and coverage. A scene
is answered by {"bytes": 0}, an error by {"error": sentence, "memory": whether memory was refused}, after which the
process ends. Empty lines before an answer say that Blender is at work.

Of Blender's add-ons Cycles alone is enabled, nothing is read from a user's or a site's folders, and no script is run.
Only this file and `scene_to_gltf.py` import bpy, Blender as a Python module, whose licence is the GPL.
"""

import json
import os
import socket
import sys
from array import array
from collections.abc import Callable, Mapping
from math import pi
from pathlib import Path
from typing import Any

from scene_attack.confinement import die_with_parent

sys.modules["numpy"] = None  # type: ignore[assignment]  # built for NumPy 1: Blender's sound, which then is left out
import bpy  # noqa: E402
from mathutils import Matrix, Vector  # noqa: E402

COAT_ROUGHNESS = 0.45
"""Roughness of the coat of every surface that is no glTF material, as in pyrender's shader."""
NORMAL_REFLECTANCE = 0.04
"""Reflectance of that coat, and of glTF's plastics, at normal incidence."""
MIN_ROUGHNESS = 0.04
"""Least roughness of a glTF material, as in pyrender's shader."""
ROUNDING = 1e-6
"""Interpolation takes an alpha that is the same at all vertices this far below it, or less."""
WHITE = (1.0, 1.0, 1.0, 1.0)
TRANSPARENT = 64
"""Surfaces that a ray may pass which are cut out or transparent."""
EXTENSIONS = {10497: "REPEAT", 33071: "EXTEND", 33648: "MIRROR"}
"""Blender's words for OpenGL's wrap modes."""


class Shader:
    """The nodes of a material, a light or the world; `add` makes one. Inputs are values or other nodes' outputs."""

    def __init__(self, tree: Any) -> None:
        self._tree = tree
        tree.nodes.clear()

    def add(self, kind: str, inputs: Mapping[Any, Any], **settings: Any) -> Any:
        """Makes a node "ShaderNode<kind>" and returns it."""
        node = self._tree.nodes.new(f"ShaderNode{kind}")
        for name, value in settings.items():
            setattr(node, name, value)
        for where, value in inputs.items():
            if isinstance(value, bpy.types.NodeSocket):
                self._tree.links.new(value, node.inputs[where])
            else:
                node.inputs[where].default_value = value
        return node

    def math(self, operation: str, *values: Any) -> Any:
        """The result of a mathematical operation."""
        return self.add("Math", dict(enumerate(values)), operation=operation).outputs[0]

    def vector(self, operation: str, *values: Any) -> Any:
        """The result of a mathematical operation on linear colours, or on single numbers for all of their channels."""
        return self.add("VectorMath", dict(enumerate(values)), operation=operation).outputs[0]

    def times(self, *colors: Any) -> Any:
        """The product of linear colours, which may be above 1."""
        product, *others = colors
        for color in others:
            product = self.vector("MULTIPLY", product, color)
        return product


class Stage:
    """A scene in Blender; of its frames camera, poses, colours and lights change.

    described: size (height, width), field_of_view (vertical, radians), near, far, bounces, threads, sky_gradient,
    shadows (softness and angle, or None) and the numbers of points, directionals and spots. Each of its parts has the
    number of its thing, a color (linear RGBA), the size of its texture (or None), whether that has holes, whether it is
    coated, and its surface: a glTF material's settings, or None. The arrays of part k are "k.vertices", "k.normals",
    "k.faces", "k.uv", "k.texture" and, of a glTF material, "k.second_uv", "k.vertex_colors" and "k.map.<name>":
    float32, int32 for faces, texels as floats with the bottom row first.
    """

    def __init__(self, described: dict[str, Any], arrays: Mapping[str, memoryview], folder: Path) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        for name in list(bpy.context.preferences.addons.keys()):
            if name != "cycles":
                bpy.ops.preferences.addon_disable(module=name)
        self._scene = bpy.context.scene
        self._arrays = arrays
        self._shadows = described["shadows"]
        self._size = described["size"]
        self._file = folder / "frame.exr"
        self._set_up(described)
        self._camera = self._placed("camera", self._lens(described))
        self._scene.camera = self._camera
        self._things: list[list[Any]] = [[] for _ in range(1 + max(part["thing"] for part in described["parts"]))]
        for k, part in enumerate(described["parts"]):
            self._things[part["thing"]].append(self._placed(f"part {k}", self._mesh(k, part)))
        self._sky = self._world(described["sky_gradient"])
        self._points = [self._light("POINT") for _ in range(described["points"])]
        self._suns = [self._light("SUN") for _ in range(described["directionals"])]
        self._spots = [self._spot() for _ in range(described["spots"])]
        self._image: Any = None

    def render(self, frame: dict[str, Any]) -> "array[float]":
        """The image of a frame: float32 [H·W·4], the bottom row first.

        camera [4][4] (world from camera); poses [things][4][4]; colors [things][3]; ambient; points [n][4] (intensity,
        position), directionals [n][4] (irradiance, unit vector towards the light), spots [n][9] (intensity, position,
        unit axis, scale and offset of the fall-off); samples of a pixel; seed.
        """
        self._camera.matrix_world = Matrix(frame["camera"])
        for parts, pose, color in zip(self._things, frame["poses"], frame["colors"], strict=True):
            for part in parts:
                part.matrix_world, part.color = Matrix(pose), (*color, 1.0)
        self._sky.default_value = frame["ambient"]
        for light, (intensity, *place) in zip(self._points, frame["points"], strict=True):
            light.data.energy, light.location = 4 * pi * intensity, place
        for light, (irradiance, *towards) in zip(self._suns, frame["directionals"], strict=True):
            light.data.energy = irradiance
            light.rotation_quaternion = Vector(towards).to_track_quat("Z", "Y")
        for (light, axis, scale, offset), values in zip(self._spots, frame["spots"], strict=True):
            light.data.energy, light.location, axis.default_value = 4 * pi * values[0], values[1:4], values[4:7]
            scale.default_value, offset.default_value = values[7:]
        self._scene.cycles.samples, self._scene.cycles.seed = frame["samples"], frame["seed"]
        self._scene.update_tag()  # else data that is kept between frames keeps the seed, too
        bpy.ops.render.render(write_still=True)
        if not self._file.exists():
            raise RuntimeError("the image was not written")
        if self._image is None:
            self._image = bpy.data.images.load(os.fspath(self._file))
            self._image.colorspace_settings.name = "Non-Color"
        else:
            self._image.reload()
        pixels = array("f", bytes(4 * 4 * self._size[0] * self._size[1]))
        self._image.pixels.foreach_get(pixels)
        self._file.unlink()  # its folder is left where this process is killed, and the next frame is another one
        return pixels

    def _set_up(self, described: dict[str, Any]) -> None:
        render, cycles = self._scene.render, self._scene.cycles
        render.engine = "CYCLES"
        render.resolution_y, render.resolution_x = self._size
        render.resolution_percentage = 100
        render.film_transparent = True
        render.use_persistent_data = True
        render.threads_mode, render.threads = "FIXED", described["threads"]
        render.use_compositing = render.use_sequencer = False
        render.filepath = os.fspath(self._file)
        settings = render.image_settings
        settings.file_format, settings.color_mode = "OPEN_EXR", "RGBA"
        settings.color_depth, settings.exr_codec = "32", "NONE"
        cycles.device = "CPU"
        cycles.pixel_filter_type = "BOX"
        cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
        cycles.light_sampling_threshold = cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
        cycles.blur_glossy = 0.0
        cycles.transparent_max_bounces = TRANSPARENT
        for limit in ("max_bounces", "diffuse_bounces", "glossy_bounces"):
            setattr(cycles, limit, described["bounces"])

    def _placed(self, name: str, data: Any) -> Any:
        placed = bpy.data.objects.new(name, data)
        placed.rotation_mode = "QUATERNION"
        self._scene.collection.objects.link(placed)
        return placed

    def _lens(self, described: dict[str, Any]) -> Any:
        lens = bpy.data.cameras.new("camera")
        lens.sensor_fit = "VERTICAL"
        lens.angle_y = described["field_of_view"]
        lens.clip_start, lens.clip_end = described["near"], described["far"]
        return lens

    def _world(self, gradient: float) -> Any:
        """The light from all around. Returns the input that is its mean radiance."""
        world = bpy.data.worlds.new("sky")
        world.cycles.sampling_method = "NONE"  # it is smooth: rays that surfaces scatter find it
        self._scene.world = world
        shader = Shader(world.node_tree)
        direction = shader.add("TexCoord", {}).outputs["Generated"]
        height = shader.add("SeparateXYZ", {0: direction}).outputs["Y"]
        mean = shader.add("Value", {}).outputs[0]
        strength = shader.math("MULTIPLY", mean, shader.math("MULTIPLY_ADD", height, gradient, 1.0))
        background = shader.add("Background", {"Color": WHITE, "Strength": strength})
        shader.add("OutputWorld", {"Surface": background.outputs[0]})
        return mean

    def _light(self, kind: str) -> Any:
        data = bpy.data.lights.new(kind, kind)
        data.use_shadow = self._shadows is not None
        softness, angle = self._shadows or (0.0, 0.0)
        if kind == "SUN":
            data.angle = 2 * angle
        else:
            data.shadow_soft_size, data.use_soft_falloff = softness, False
        light = self._placed(kind, data)
        light.visible_camera = False
        return light

    def _spot(self) -> tuple[Any, Any, Any, Any]:
        """A light that shines into a cone with glTF's fall-off, which Blender's own spot light has not.

        Returns it and the inputs of its axis, and of the scale and offset of its fall-off.
        """
        light = self._light("POINT")
        light.data.use_nodes = True
        shader = Shader(light.data.node_tree)
        leaving = shader.add("NewGeometry", {}).outputs["Incoming"]
        cosine = shader.add("VectorMath", {0: leaving}, operation="DOT_PRODUCT")
        along = shader.add("Math", {0: cosine.outputs["Value"]}, operation="MULTIPLY_ADD", use_clamp=True)
        strength = shader.math("MULTIPLY", along.outputs[0], along.outputs[0])
        emission = shader.add("Emission", {"Strength": strength})
        shader.add("OutputLight", {"Surface": emission.outputs[0]})
        return light, cosine.inputs[1], along.inputs[1], along.inputs[2]

    def _mesh(self, k: int, part: dict[str, Any]) -> Any:
        mesh = bpy.data.meshes.new(f"part {k}")
        vertices, faces = self._floats(f"{k}.vertices"), self._arrays[f"{k}.faces"].cast("i")
        mesh.vertices.add(len(vertices) // 3)
        mesh.vertices.foreach_set("co", vertices)
        mesh.loops.add(len(faces))
        mesh.loops.foreach_set("vertex_index", faces)
        mesh.polygons.add(len(faces) // 3)
        mesh.polygons.foreach_set("loop_start", array("i", range(0, len(faces), 3)))
        for number, name in enumerate(("uv", "second_uv")):
            if f"{k}.{name}" in self._arrays:
                uv = self._floats(f"{k}.{name}")
                layer = mesh.attributes.new(f"uv {number}", "FLOAT2", "CORNER")
                layer.data.foreach_set("vector", array("f", [uv[2 * v + c] for v in faces for c in (0, 1)]))
        if f"{k}.vertex_colors" in self._arrays:
            layer = mesh.attributes.new("vertex color", "FLOAT_COLOR", "POINT")
            layer.data.foreach_set("color", self._floats(f"{k}.vertex_colors"))
        mesh.update()
        normals = mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
        normals.data.foreach_set("vector", self._floats(f"{k}.normals"))
        mesh.materials.append(self._material(k, part))
        return mesh

    def _material(self, k: int, part: dict[str, Any]) -> Any:
        material = bpy.data.materials.new(f"part {k}")
        material.cycles.emission_sampling = "NONE"
        shader = Shader(material.node_tree)
        surface = _lambertian if part["surface"] is None else _metallic_roughness
        closure = surface(shader, part, lambda name, *about: self._texture(shader, f"{k}.{name}", *about))
        shader.add("OutputMaterial", {"Surface": closure})
        return material

    def _texture(self, shader: Shader, name: str, size: list[int], uv: int, wrap: list[int], linear: bool) -> Any:
        """The node of a texture of height and width `size`, laid out in a set of coordinates."""
        image = bpy.data.images.new(name, size[1], size[0], alpha=True)
        image.colorspace_settings.name = "Non-Color" if linear else "sRGB"
        image.alpha_mode = "CHANNEL_PACKED"
        image.pixels.foreach_set(self._floats(name))
        image.pack()
        extension = EXTENSIONS[wrap[0] if wrap[0] == wrap[1] else 10497]
        where = shader.add("UVMap", {}, uv_map=f"uv {uv}").outputs[0]
        return shader.add("TexImage", {0: where}, image=image, extension=extension)

    def _floats(self, name: str) -> "memoryview[float]":
        return self._arrays[name].cast("f")


Textures = Callable[..., Any]


def _base(shader: Shader, part: dict[str, Any], *factors: Any) -> Any:
    """The linear base colour: the thing's own in a frame, the part's, and what else multiplies them."""
    return shader.times(shader.add("ObjectInfo", {}).outputs["Color"], tuple(part["color"][:3]), *factors)


def _shown(shader: Shader, opacity: Any, closure: Any) -> Any:
    """A closure through which light passes by 1 − opacity."""
    clear = shader.add("BsdfTransparent", {}).outputs[0]
    return shader.add("MixShader", {0: opacity, 1: clear, 2: closure}).outputs[0]


def _reflection(shader: Shader, reflectance: Any, roughness: Any, normal: dict[str, Any]) -> Any:
    """GGX reflection with Schlick's Fresnel term, which Blender's metal has where its tint at the edge is white."""
    inputs = {"Base Color": reflectance, "Edge Tint": WHITE, "Roughness": roughness, **normal}
    return shader.add("BsdfMetallic", inputs, distribution="GGX", fresnel_type="F82").outputs[0]


def _lambertian(shader: Shader, part: dict[str, Any], texture: Textures) -> Any:
    """A Lambertian body under a coat that takes no light from it, as pyrender's `radiance.frag` has it."""
    texels = None if part["texture"] is None else texture("texture", part["texture"], 0, (10497, 10497), False)
    base = _base(shader, part, *(() if texels is None else (texels.outputs["Color"],)))
    closure = shader.add("BsdfDiffuse", {"Color": base}).outputs[0]
    if part["color"][3] < 1:
        closure = _shown(shader, part["color"][3], closure)
    if part["coated"]:
        coat = _reflection(shader, (*(NORMAL_REFLECTANCE,) * 3, 1.0), COAT_ROUGHNESS, {})
        closure = shader.add("AddShader", {0: closure, 1: coat}).outputs[0]
    if texels is not None and part["holes"]:
        closure = _shown(shader, shader.math("GREATER_THAN", texels.outputs["Alpha"], 0.5 - ROUNDING), closure)
    return closure


def _metallic_roughness(shader: Shader, part: dict[str, Any], texture: Textures) -> Any:
    """A glTF material as pyrender's `radiance.frag` has it, but for its map of occlusion, which rays need not.

    Of the light, the body has there 1 − F by the half vector of each lamp, which no node knows; here it is 1 − the
    reflectance at normal incidence, which is the same but for grazing light.
    """
    surface = part["surface"]
    maps = {
        name: texture(f"map.{name}", *about, name not in ("base_color", "emissive"))
        for name, about in surface["maps"].items()
    }
    vertex = shader.add("Attribute", {}, attribute_name="vertex color")
    factors, opacity = [vertex.outputs["Color"]], shader.math("MULTIPLY", vertex.outputs["Alpha"], part["color"][3])
    if "base_color" in maps:
        factors.append(maps["base_color"].outputs["Color"])
        opacity = shader.math("MULTIPLY", opacity, maps["base_color"].outputs["Alpha"])
    base = _base(shader, part, *factors)
    texel: Mapping[str, Any] = {"Green": 1.0, "Blue": 1.0}
    if "metallic_roughness" in maps:
        texel = shader.add("SeparateColor", {0: maps["metallic_roughness"].outputs["Color"]}).outputs
    metallic = shader.math("MULTIPLY", surface["metallic"], texel["Blue"])
    roughness = shader.math("MAXIMUM", MIN_ROUGHNESS, shader.math("MULTIPLY", surface["roughness"], texel["Green"]))
    dielectric = shader.math("SUBTRACT", 1.0, metallic)
    reflectance = shader.vector("MULTIPLY_ADD", base, metallic, shader.math("MULTIPLY", NORMAL_REFLECTANCE, dielectric))
    passing = shader.vector("SUBTRACT", WHITE[:3], reflectance)
    body = shader.times(base, shader.math("MULTIPLY", 1 - NORMAL_REFLECTANCE, dielectric), passing)
    normal: dict[str, Any] = {}
    if "normal" in maps:
        uv = f"uv {surface['maps']['normal'][1]}"
        bent = {"Strength": surface["normal_scale"], "Color": maps["normal"].outputs["Color"]}
        normal["Normal"] = shader.add("NormalMap", bent, uv_map=uv).outputs[0]
    closure = shader.add("BsdfDiffuse", {"Color": body, **normal}).outputs[0]
    closure = shader.add("AddShader", {0: closure, 1: _reflection(shader, reflectance, roughness, normal)}).outputs[0]
    if any(surface["emissive"]):
        texels = (maps["emissive"].outputs["Color"],) if "emissive" in maps else ()
        emission = shader.add("Emission", {"Color": shader.times(tuple(surface["emissive"]), WHITE[:3], *texels)})
        closure = shader.add("AddShader", {0: closure, 1: emission.outputs[0]}).outputs[0]
    if surface["alpha_mode"] == "OPAQUE":
        opacity = 1.0
    elif surface["alpha_mode"] == "MASK":
        opacity = shader.math("GREATER_THAN", opacity, surface["alpha_cutoff"] - ROUNDING)
    if not surface["double_sided"]:
        outside = shader.math("SUBTRACT", 1.0, shader.add("NewGeometry", {}).outputs["Backfacing"])
        opacity = shader.math("MULTIPLY", opacity, outside)
    return closure if opacity == 1.0 else _shown(shader, opacity, closure)


def serve(connection: socket.socket, folder: Path) -> None:
    """Answers messages until there are no more, or one could not be answered. Files are written to the folder."""

    def busy(*_: object) -> None:
        connection.sendall(b"\n")

    stage: Stage | None = None
    requests = connection.makefile("rb")
    while line := requests.readline():
        message = json.loads(line)
        arrays = {name: memoryview(requests.read(count)) for name, count in message["arrays"]}
        try:
            image = array("f")
            if "frame" in message:
                assert stage is not None, "a frame needs a scene"
                image = stage.render(message["frame"])
            else:
                stage = Stage(message["scene"], arrays, folder)
                bpy.app.handlers.render_stats.append(busy)  # factory settings, which a scene begins with, have none
        except Exception as error:
            memory = isinstance(error, MemoryError) or "out of memory" in str(error).lower()
            answer = {"error": " ".join(f"{type(error).__name__}: {error}".split()), "memory": memory}
            connection.sendall(json.dumps(answer).encode() + b"\n")
            return
        head = json.dumps({"bytes": image.itemsize * len(image)}).encode()
        connection.sendall(head + b"\n" + image.tobytes())  # at once: another thread may still say that it is at work


if __name__ == "__main__":
    die_with_parent()
    serve(socket.socket(fileno=int(sys.argv[1])), Path(sys.argv[2]))
