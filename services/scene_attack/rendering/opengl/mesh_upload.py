"""Compiled shaders, and meshes, textures and glTF materials as OpenGL holds them. Imports OpenGL, so import it only
through `context.current()`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL
from pyrender.material import MetallicRoughnessMaterial
from pyrender.primitive import Primitive
from pyrender.shader_program import ShaderProgram
from pyrender.texture import Texture

from scene_attack.scenes.image_file import to_linear
from scene_attack.scenes.mesh import Integers, MapName, Mesh, MetallicRoughness, Part, TextureMap
from scene_attack.scenes.solids import has_holes, outsides

SHADERS = Path(__file__).parent / "shaders"
JOINED = {"METALLIC_ROUGHNESS": "metallic_roughness.frag", "SHADOWS": "shadows.frag"}
"""Files that are joined behind `surface.frag` where a constant is 1."""
EXTENSIONS = ("shading_language_420pack", "texture_gather")
"""Extensions that `shadows.frag` needs beyond OpenGL 3.3."""


class Program(ShaderProgram):  # type: ignore[misc]
    """A compiled shader program that refuses a uniform it does not have.

    `constants` are the numbers it is compiled for (`surface.vert` lists them): a loop over as many lights as there are,
    and no look at a texture where there is none, halve the time of a frame.
    """

    def __init__(self, fragment: str, constants: Mapping[str, int]) -> None:
        self._joined = [name for constant, name in JOINED.items() if constants[constant]]
        needed = "".join(f"#extension GL_ARB_{name} : require\n" for name in EXTENSIONS) * constants["SHADOWS"]
        self._head = needed + "".join(f"#define {name} {value}\n" for name, value in constants.items())
        super().__init__(str(SHADERS / "surface.vert"), str(SHADERS / fragment))
        self._locations: dict[str, int] = {}
        self._add_to_context()

    def _load(self, path: str) -> str:
        whole = Path(path).read_text()
        if path.endswith(".frag"):
            whole = "".join((SHADERS / name).read_text() for name in ("surface.frag", *self._joined)) + whole
        version, rest = whole.split("\n", 1)
        return f"{version}\n{self._head}{rest}"

    def has(self, name: str) -> bool:
        """Whether the linked program uses a uniform."""
        if name not in self._locations:
            self._locations[name] = GL.glGetUniformLocation(self._program_id, name)
        return self._locations[name] >= 0

    def set(self, name: str, value: Any) -> None:
        """Set a float or int, a vector, a 3x3 or 4x4 matrix, or an array of floats or of vectors ("name[0]").

        Raises KeyError for a uniform the linked program does not use.
        """
        if not self.has(name):
            raise KeyError(f"{Path(self.fragment_shader).name} has no uniform {name!r}")
        location = self._locations[name]
        if isinstance(value, int):
            GL.glUniform1i(location, value)
        elif isinstance(value, float):
            GL.glUniform1f(location, value)
        else:
            with np.errstate(over="ignore"):  # becomes infinite, and the image is refused for it
                value = np.ascontiguousarray(value, dtype=np.float32)
            if name.endswith("[0]"):
                (GL.glUniform1fv if value.ndim == 1 else GL.glUniform3fv)(location, len(value), value)
            elif value.ndim == 1:
                (GL.glUniform3fv if len(value) == 3 else GL.glUniform4fv)(location, 1, value)
            else:
                setter = GL.glUniformMatrix3fv if len(value) == 3 else GL.glUniformMatrix4fv
                setter(location, 1, GL.GL_TRUE, value)


LINEAR = to_linear(np.arange(256) / 255).astype(np.float32)
"""The linear value of each 8-bit sRGB value."""


class LinearTexture(Texture):  # type: ignore[misc]
    """An RGBA texture with mipmaps; `wrap`: OpenGL's modes for u and v."""

    _format = GL.GL_RGBA8
    wrap: tuple[int, int] = (GL.GL_REPEAT, GL.GL_REPEAT)

    def _add_to_context(self) -> None:
        height, width = self.source.shape[:2]
        self._texid = int(GL.glGenTextures(1))
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
        # OpenGL's first row is v = 0, the bottom of the image.
        rows = np.ascontiguousarray(self.source[::-1])
        GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, self._format, width, height, 0, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, rows)
        GL.glGenerateMipmap(GL.GL_TEXTURE_2D)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR)
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_S, self.wrap[0])
        GL.glTexParameteri(GL.GL_TEXTURE_2D, GL.GL_TEXTURE_WRAP_T, self.wrap[1])
        GL.glBindTexture(GL.GL_TEXTURE_2D, 0)


class SrgbTexture(LinearTexture):
    """A texture in sRGB, decoded to linear before it is filtered (pyrender's are filtered as they are stored)."""

    _format = GL.GL_SRGB8_ALPHA8
    _levels: list[NDArray[np.float32]] | None = None

    def levels(self) -> list[NDArray[np.float32]]:
        """The driver's mipmaps, once uploaded: each [height, width, 4], linear red, green and blue, and alpha, all in
        [0,1], with its first row at v = 0."""
        if self._levels is None:
            self._levels = []
            GL.glPixelStorei(GL.GL_PACK_ALIGNMENT, 1)
            GL.glBindTexture(GL.GL_TEXTURE_2D, self._texid)
            size = np.array(self.source.shape[:2])
            for level in range(int(size.max()).bit_length()):
                texels = np.empty((*np.maximum(size >> level, 1), 4), np.uint8)
                GL.glGetTexImage(GL.GL_TEXTURE_2D, level, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, array=texels)
                linear = LINEAR[texels]
                linear[..., 3] = texels[..., 3] / np.float32(255)
                self._levels.append(linear)
            GL.glBindTexture(GL.GL_TEXTURE_2D, 0)
        return self._levels


NO_MATERIAL = {"METALLIC_ROUGHNESS": 0}
"""Constants of `Program` for surfaces without a glTF material."""

_SRGB = ("base_color", "emissive")
_MODES = {"OPAQUE": 0, "MASK": 1, "BLEND": 2}
_NAMES: tuple[MapName, ...] = ("base_color", "metallic_roughness", "normal", "occlusion", "emissive")

Textures = dict[tuple[int, bool, tuple[int, int]], LinearTexture]
"""Textures by the identity of the array of texels, whether it is sRGB, and how it wraps; each is uploaded once."""


@dataclass(frozen=True, eq=False)
class UploadedMaterial:
    """A material, its textures and the constants of `Program` that draw it."""

    material: MetallicRoughness
    opacity: float
    textures: Mapping[MapName, LinearTexture]

    @property
    def constants(self) -> dict[str, int]:
        """The constants that `metallic_roughness.frag` is compiled for."""
        maps = self.material.maps
        sets = {f"{name.upper()}_MAP": maps[name].uv_set + 1 if name in maps else 0 for name in _NAMES}
        kind = {"ALPHA_MODE": _MODES[self.material.alpha_mode], "GIVEN": int(self.material.given)}
        return {"METALLIC_ROUGHNESS": 1, **kind, **sets}

    def bind(self, program: Program) -> None:
        """Set the uniforms that the program uses, and bind the textures."""
        m = self.material
        values = {
            "opacity": self.opacity,
            "metallic": m.metallic,
            "roughness": m.roughness,
            "emissive": np.array(m.emissive),
            "alpha_cutoff": m.alpha_cutoff,
            "normal_scale": m.normal_scale,
            "occlusion_strength": m.occlusion_strength,
        }
        for name, value in values.items():
            if program.has(name):
                program.set(name, value)
        for unit, (name, texture) in enumerate(self.textures.items()):
            if program.has(f"{name}_map"):
                program.set(f"{name}_map", unit)
                GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
                texture._bind()
        GL.glActiveTexture(GL.GL_TEXTURE0)


def upload_material(
    part: Part, material: MetallicRoughness, faces: Integers, textures: Textures
) -> tuple[Primitive, UploadedMaterial]:
    """The primitive of a part with a glTF material, with all vertex attributes of `surface.vert`, and the material."""
    held = {name: _texture(name, texture_map, textures) for name, texture_map in material.maps.items()}
    primitive = Primitive(
        positions=part.vertices,
        normals=part.normals,
        tangents=material.tangents,
        texcoord_0=part.uv,
        texcoord_1=material.second_uv,
        color_0=material.vertex_colors,
        indices=faces,
        # For pyrender, which uploads the textures of a primitive's material.
        material=MetallicRoughnessMaterial(
            baseColorTexture=held.get("base_color"),
            metallicRoughnessTexture=held.get("metallic_roughness"),
            normalTexture=held.get("normal"),
            occlusionTexture=held.get("occlusion"),
            emissiveTexture=held.get("emissive"),
        ),
    )
    return primitive, UploadedMaterial(material, float(part.color[3]), held)


def _texture(name: MapName, texture_map: TextureMap, textures: Textures) -> LinearTexture:
    srgb = name in _SRGB
    key = id(texture_map.texels), srgb, texture_map.wrap
    if key not in textures:
        textures[key] = (SrgbTexture if srgb else LinearTexture)(source=texture_map.texels, source_channels="RGBA")
        textures[key].wrap = texture_map.wrap
    return textures[key]


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Piece:
    """One part of one object, ready to draw. Of its faces the first `n_watertight_faces` belong to watertight
    surfaces (see `watertight`)."""

    index: int
    part: Part
    triangles: Integers
    """int32 [F, 3], in the order they are drawn."""
    primitive: Any
    texture: LinearTexture | None
    holes: bool
    n_watertight_faces: int
    centre: Array
    material: UploadedMaterial | None

    @property
    def metallic_roughness(self) -> MetallicRoughness | None:
        """The material of a glTF file; None for the Lambertian body under a coat that all other surfaces have."""
        return self.part.metallic_roughness

    @property
    def solid(self) -> bool:
        """Whether nothing shows through it."""
        if self.metallic_roughness is not None:
            return self.metallic_roughness.alpha_mode != "BLEND"
        return bool(self.part.color[3] >= 1)

    @property
    def single_sided(self) -> bool:
        """Whether a face is seen from its front only."""
        return self.metallic_roughness is not None and not self.metallic_roughness.double_sided

    @property
    def faces(self) -> int:
        """Number of triangles."""
        return len(self.part.faces)


@dataclass(frozen=True, eq=False)
class Upload:
    """A group of primitives that are uploaded together, with the attributes that pyrender's renderer reads."""

    primitives: tuple[Any, ...]


class Drawing:
    """The geometry of a scene's objects as pyrender primitives; uploaded when first drawn, dropped when another is.

    Unless `watertight`, no surface is taken for watertight: all faces are drawn alike, and the nearest is seen.
    """

    def __init__(self, meshes: Sequence[Mesh], watertight: bool = False) -> None:
        textures: Textures = {}
        uploads: dict[int, list[Piece]] = {}
        corners: dict[int, Array] = {}
        self.pieces: list[Piece] = []
        self.points: list[Array] = []
        """Corners of each object, homogeneous [4, V]."""
        for index, mesh in enumerate(meshes):
            if id(mesh) not in uploads:
                wound = outsides(mesh) if watertight else [(part.faces, 0) for part in mesh.parts]
                uploads[id(mesh)] = [
                    _upload(index, part, np.ascontiguousarray(faces, np.int32), count, textures)
                    for part, (faces, count) in zip(mesh.parts, wound, strict=True)
                ]
                corners[id(mesh)] = _corners(mesh, watertight)
            self.pieces += [replace(piece, index=index) for piece in uploads[id(mesh)]]
            self.points.append(corners[id(mesh)])
        # What pyrender's Renderer._update_context asks of a scene.
        self.meshes = {Upload(tuple(piece.primitive for piece in pieces)) for pieces in uploads.values()}
        self.lights: tuple[()] = ()


@lru_cache(maxsize=1)
def closed_drawing(meshes: tuple[Mesh, ...]) -> Drawing:
    """The drawing of meshes with their watertight surfaces. The last one is kept: a job that attacks the same meshes as
    the one before finds them prepared, and uploaded.
    """
    return Drawing(meshes, watertight=True)


def _corners(mesh: Mesh, once: bool) -> Array:
    """Returns a mesh's vertices, homogeneous [4, V]; `once`: each once, which pays for a mesh that is drawn often."""
    vertices = np.concatenate([part.vertices for part in mesh.parts])
    vertices = (np.unique(vertices, axis=0) if once else vertices).astype(np.float64)
    return np.ascontiguousarray(np.append(vertices, np.ones((len(vertices), 1)), axis=1).T)


def _upload(index: int, part: Part, faces: Integers, n_watertight_faces: int, textures: Textures) -> Piece:
    texture, material = None, None
    if part.metallic_roughness is not None:
        primitive, material = upload_material(part, part.metallic_roughness, faces, textures)
    else:
        if part.texture is not None and part.uv is not None:
            key = id(part.texture), True, LinearTexture.wrap
            texture = textures.setdefault(key, SrgbTexture(source=part.texture, source_channels="RGBA"))
        primitive = Primitive(
            positions=part.vertices,
            normals=part.normals,
            # One vertex layout for all.
            texcoord_0=np.zeros((len(part.vertices), 2), np.float32) if part.uv is None else part.uv,
            indices=faces,
            material=MetallicRoughnessMaterial(baseColorTexture=texture),
        )
    centre = (part.vertices.min(axis=0) + part.vertices.max(axis=0)).astype(np.float64) / 2
    return Piece(index, part, faces, primitive, texture, has_holes(part), n_watertight_faces, centre, material)
