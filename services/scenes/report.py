"""Says what of an uploaded mesh and its files is shown, and what is not, in short phrases for people."""

import re
from collections.abc import Sequence
from contextlib import suppress

from PIL import Image

from services.scenes.archive import unpack_archive
from services.scenes.beside import Beside
from services.scenes.claims import MAX_3MF
from services.scenes.gltf_file import GltfFile
from services.scenes.image_file import open_texture
from services.scenes.mesh import Part
from services.scenes.phrases import Report, shortened
from services.scenes.references import texture_name
from services.scenes.surfaces import MAX_TEXTURE
from services.scenes.wavefront import read_opacity

_3MF = {b"<basematerials": "materials", b":colorgroup": "colours", b":texture2d": "textures"}
"""What a model in a 3mf file may have, and the parser passes over."""
_NOT_DRAWN = {"animations": "animations", "skins": "skins", "cameras": "cameras"}


def report(data: bytes, kind: str, beside: Beside, parts: Sequence[Part], notes: Sequence[str]) -> Report:
    """Returns what became of what a mesh file holds and names.

    `parts` are those that were read from it, and `notes` what was said of it then to be not shown.
    """
    used, dropped = _files(beside, any(part.textured for part in parts))
    dropped = [*notes, *dropped]
    if kind == "obj" and re.search(rb"(?m)^[ \t]*v(?:[ \t]+[-+.\deE]+){6}", data):
        hidden = beside.libraries() or re.search(rb"(?m)^[ \t]*f[ \t]+-?\d+/-?\d", data)
        (dropped if hidden else used).append("vertex colours")
    if kind == "off" and data.startswith(b"COFF"):
        dropped.append("vertex colours")
    if kind == "ply" and (red := re.search(rb"(?m)^property \w+ red\b", data[: data.find(b"end_header")])):
        said = "face colours" if b"element face" in data[: red.start()] else "vertex colours"
        (dropped if any(one.startswith("texture ") for one in used) else used).append(said)
    if kind in ("glb", "gltf"):
        more, less = _gltf(GltfFile(data.removeprefix(b"\xef\xbb\xbf"), beside), parts)
        used, dropped = used + more, dropped + less
    if kind == "dae" and b'semantic="COLOR"' in data:
        (dropped if b"<instance_material" in data else used).append("vertex colours")
    if "vertex colours" in used and kind not in ("glb", "gltf"):
        dropped.append("blends of vertex colours: each triangle has the mean of its corners")
    if any(_is_partly_opaque(part) for part in parts):
        dropped.append("partial opacity of colours: below a half is cut out, the rest is opaque")
    if kind == "3mf":
        models = b"".join(one for name, one in unpack_archive(data, MAX_3MF).items() if name.lower().endswith(".model"))
        dropped += [word for mark, word in _3MF.items() if mark in models]
    return Report(shortened(used), shortened(dropped))


def _files(beside: Beside, textured: bool) -> tuple[list[str], list[str]]:
    used: list[str] = []
    dropped: list[str] = []
    found: set[str | None] = set()
    for one in beside.named:
        path = beside.find(one.name)
        said = f"{one.what} {path or one.name}"
        found.add(path)
        if path is None:
            dropped.append(f"{said} missing")
        elif not one.is_shown:
            dropped.append(f"{said} not used")
        elif one.what == "texture" and not textured:
            dropped.append(f"{said} not used: the mesh has no texture coordinates")
        else:
            used.append(said)
            dropped += _detail(said, open_texture(beside.data(path), path)) if one.what == "texture" else []
    for options in re.findall(r"(?mi)^\s*map_Kd\s+(-\S.*)$", beside.libraries()):
        words, name = texture_name(options)
        dropped.append(f"options {words} of the texture {name}")
    dropped += [
        f"opacity 0 of the material {name}" for name, value in read_opacity(beside.libraries()).items() if not value
    ]
    dropped += [f"{path} not used: the mesh does not name it" for path in beside.paths if path not in found]
    return used, dropped


def _is_partly_opaque(part: Part) -> bool:
    """Whether a surface that no glTF file describes has texels between opaque and transparent."""
    if part.texture is None:
        return False
    opacity = part.texture[..., 3]
    return bool(((opacity > 0) & (opacity < 255)).any())


def _detail(said: str, image: Image.Image) -> list[str]:
    """What of a texture's texels is not shown."""
    if max(image.size) <= MAX_TEXTURE:
        return []
    return [f"detail of {said}: {image.width}×{image.height} texels, of which at most {MAX_TEXTURE} a side are shown"]


def _gltf(file: GltfFile, parts: Sequence[Part]) -> tuple[list[str], list[str]]:
    materials = [part.metallic_roughness for part in parts if part.metallic_roughness is not None]
    names = dict.fromkeys(name for material in materials for name in material.maps)
    used = [f"{name.replace('_', ' ')} map" for name in names]
    if any((material.vertex_colors != 1).any() for material in materials):
        used.append("vertex colours")
    tree = file.tree
    dropped = [word for key, word in _NOT_DRAWN.items() if tree.get(key)]
    if any(primitive.get("targets") for mesh in tree.get("meshes", []) for primitive in mesh.get("primitives", [])):
        dropped.append("morph targets")
    for index in range(len(file.array("images"))):
        with suppress(ValueError):  # one that nothing shows, or the mesh would have been refused
            uri = file.item("images", index).get("uri", "data:")
            # `_files` knows those in files of their own.
            dropped += _detail(f"images[{index}]", file.image(index)) if str(uri).startswith("data:") else []
    read = ("KHR_mesh_quantization", "EXT_texture_webp")
    dropped += [f"extension {name}" for name in file.array("extensionsUsed") if name not in read]
    return used, dropped
