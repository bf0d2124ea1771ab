"""Reads and validates the metallic-roughness materials of a glTF file (Khronos, glTF 2.0 specification, 3.9)."""

from contextlib import suppress
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from services.scenes.gltf_file import GltfFile, MissingFile, number, numbers
from services.scenes.image_file import FORMATS
from services.scenes.mesh import AlphaMode, Floats, MapName, MaterialSettings, TextureMap
from services.scenes.surfaces import Textures
from services.scenes.unreadable import Unreadable

_WRAPS = (10497, 33071, 33648)
_MODES: tuple[AlphaMode, ...] = ("OPAQUE", "MASK", "BLEND")


@dataclass(frozen=True, eq=False)
class Material(MaterialSettings):
    """A material of a glTF file, with glTF's defaults. color: float32 [4], the base colour factor, linear RGBA."""

    color: Floats


def read_material(file: GltfFile, index: Any, textures: Textures) -> Material:
    """Reads materials[index]; None is glTF's default material: white, metallic 1, roughness 1.

    Raises Unreadable, which names the property, for factors that are not finite or out of range, unknown alpha modes,
    and textures that are not images.
    """
    entry = {} if index is None else file.item("materials", index)
    where = "material" if index is None else f"materials[{index}]"
    surface = entry.get("pbrMetallicRoughness", {})
    if not isinstance(surface, dict):
        raise Unreadable(f"{where}.pbrMetallicRoughness is not an object")
    inner = f"{where}.pbrMetallicRoughness"
    mode = entry.get("alphaMode", "OPAQUE")
    if mode not in _MODES:
        raise Unreadable(f"{where}.alphaMode is {mode!r}; glTF has {', '.join(_MODES)}")
    double_sided = entry.get("doubleSided", False)
    if not isinstance(double_sided, bool):
        raise Unreadable(f"{where}.doubleSided is {double_sided!r}, which is neither true nor false")
    color = numbers(surface, "baseColorFactor", (1.0, 1.0, 1.0, 1.0), 0, 1, inner).astype(np.float32)
    if mode == "OPAQUE":
        color[3] = 1.0
    red, green, blue = numbers(entry, "emissiveFactor", (0.0, 0.0, 0.0), 0, 1, where)
    maps: dict[MapName, TextureMap] = {}
    places: tuple[tuple[MapName, dict[str, Any], str], ...] = (
        ("base_color", surface, "baseColorTexture"),
        ("metallic_roughness", surface, "metallicRoughnessTexture"),
        ("normal", entry, "normalTexture"),
        ("occlusion", entry, "occlusionTexture"),
        ("emissive", entry, "emissiveTexture"),
    )
    for name, owner, key in places:
        if key in owner:
            with suppress(MissingFile):  # it is drawn without, and the upload's answer says so
                maps[name] = _map(file, owner[key], textures, f"{inner if owner is surface else where}.{key}")
    return Material(
        color=color,
        metallic=number(surface, "metallicFactor", 1.0, 0, 1, inner),
        roughness=number(surface, "roughnessFactor", 1.0, 0, 1, inner),
        emissive=(float(red), float(green), float(blue)),
        alpha_mode=mode,
        alpha_cutoff=number(entry, "alphaCutoff", 0.5, 0, inf, where),
        double_sided=double_sided,
        normal_scale=number(entry.get("normalTexture", {}), "scale", 1.0, -1e3, 1e3, f"{where}.normalTexture"),
        occlusion_strength=number(
            entry.get("occlusionTexture", {}), "strength", 1.0, 0, 1, f"{where}.occlusionTexture"
        ),
        maps=maps,
    )


def _map(file: GltfFile, info: Any, textures: Textures, where: str) -> TextureMap:
    if not isinstance(info, dict):
        raise Unreadable(f"{where} is not an object")
    uv_set = info.get("texCoord", 0)
    if uv_set not in (0, 1):
        raise Unreadable(f"{where}.texCoord is {uv_set!r}; TEXCOORD_0 and TEXCOORD_1 are read")
    texture = file.item("textures", info.get("index"))
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source")
    source = texture.get("source", webp)
    if source is None:
        raise Unreadable(f"{where} has no image in {FORMATS}")
    sampler = file.item("samplers", texture["sampler"]) if "sampler" in texture else {}
    wrap = sampler.get("wrapS", _WRAPS[0]), sampler.get("wrapT", _WRAPS[0])
    if not all(mode in _WRAPS for mode in wrap):
        raise Unreadable(f"{where} wraps as {wrap!r}; glTF has {', '.join(map(str, _WRAPS))}")
    try:
        texels = textures.read(file.image(source))
    except (OSError, SyntaxError) as error:  # its header is intact, its data is not
        raise Unreadable(f"{where}: images[{source}] is not a readable {FORMATS} image") from error
    return TextureMap(texels, uv_set, wrap)
