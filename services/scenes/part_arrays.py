"""Sends the parts of a mesh between processes as plain arrays, and checks them on arrival.

The bytes are a safetensors file, in which nothing can be run: the arrays, and a JSON document with the rest. A texture
that several parts use is sent once.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from safetensors.numpy import load, save

from services.scenes.image_file import MAX_PIXELS
from services.scenes.mesh import FIT_RADIUS, AlphaMode, MapName, MetallicRoughness, Part, TextureMap
from services.scenes.phrases import LENGTH, MOST, Report

Arrays = Mapping[str, NDArray[Any]]
Unit = Annotated[float, Field(ge=0, le=1)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Index = Annotated[int, Field(ge=0)]
Phrase = Annotated[str, Field(max_length=LENGTH)]
_ATTRIBUTES = {"tangents": 4, "second_uv": 2, "vertex_colors": 4}
_ROUNDING = 1.001


class _Record(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")


class _Map(_Record):
    texels: Index
    uv_set: Literal[0, 1]
    wrap: Annotated[list[Literal[10497, 33071, 33648]], Field(min_length=2, max_length=2)]


class _Material(_Record):
    metallic: Unit
    roughness: Unit
    emissive: Annotated[list[Unit], Field(min_length=3, max_length=3)]
    alpha_mode: AlphaMode
    alpha_cutoff: Annotated[Finite, Field(ge=0)]
    double_sided: bool
    normal_scale: Finite
    occlusion_strength: Unit
    maps: dict[MapName, _Map]


class _Part(_Record):
    uv: bool
    texels: Index | None
    material: _Material | None


class _Document(_Record):
    parts: Annotated[list[_Part], Field(min_length=1)]
    used: Annotated[list[Phrase], Field(max_length=MOST)]
    dropped: Annotated[list[Phrase], Field(max_length=MOST)]


def pack(parts: tuple[Part, ...], report: Report) -> bytes:
    """Returns the parts of a mesh and what became of its files as bytes for `unpack`."""
    arrays: dict[str, NDArray[Any]] = {}
    textures: dict[int, int] = {}

    def texels(array: NDArray[Any]) -> int:
        number = textures.setdefault(id(array), len(textures))
        arrays[f"texels.{number}"] = array
        return number

    records = []
    for k, part in enumerate(parts):
        own = part.metallic_roughness
        given = {name: getattr(part, name) for name in ("vertices", "normals", "faces", "color", "uv")}
        given |= {} if own is None else {name: getattr(own, name) for name in _ATTRIBUTES}
        arrays |= {f"{k}.{name}": array for name, array in given.items() if array is not None}
        texture = None if part.texture is None else texels(part.texture)
        material = None if own is None else _material_record(own, texels)
        records.append(_Part(uv=part.uv is not None, texels=texture, material=material))
    document = _Document(parts=records, used=list(report.used), dropped=list(report.dropped)).model_dump_json().encode()
    arrays["document"] = np.frombuffer(document, np.uint8)
    return save({name: np.ascontiguousarray(array) for name, array in arrays.items()})


def unpack(data: bytes, max_faces: int) -> tuple[tuple[Part, ...], Report]:
    """Returns what `pack` was given. The sender is not trusted.

    Raises ValueError if an array or a setting is missing, has another shape or type than `Part` says, has numbers that
    are not finite or out of range, or if there are more than `max_faces` triangles.
    """
    arrays = _load(data)
    document = _Document.model_validate_json(_array(arrays, "document", np.uint8, None).tobytes())
    textures = [
        _array(arrays, f"texels.{k}", np.uint8, None, None, 4) for k in range(len(arrays)) if f"texels.{k}" in arrays
    ]
    if sum(texture.size for texture in textures) > 4 * MAX_PIXELS:
        raise ValueError("it has too many texels")
    parts = tuple(_part(arrays, k, record, textures) for k, record in enumerate(document.parts))
    if sum(len(part.faces) for part in parts) > max_faces:
        raise ValueError(f"it has more than {max_faces:,} triangles")
    return parts, Report(tuple(document.used), tuple(document.dropped))


def _load(data: bytes) -> Arrays:
    try:
        return load(data)
    except Exception as error:  # safetensors has a class of its own, which is no ValueError
        raise ValueError(f"it is no safetensors file: {error}") from error


def _array(arrays: Arrays, name: str, kind: type[np.generic], *shape: int | None) -> NDArray[Any]:
    """Returns an array of a type and shape, in which None is any length of at least 1, with finite values."""
    found = arrays.get(name)
    if found is None or found.dtype != kind or found.ndim != len(shape):
        raise ValueError(f"{name} is not there, or is no array of {len(shape)} dimensions of {kind.__name__}")
    if any(length == 0 or wanted not in (None, length) for length, wanted in zip(found.shape, shape, strict=True)):
        raise ValueError(f"{name} has the shape {found.shape}")
    if found.dtype.kind == "f" and not np.isfinite(found).all():
        raise ValueError(f"{name} has values that are not finite numbers")
    return found


def _part(arrays: Arrays, k: int, record: _Part, textures: list[NDArray[Any]]) -> Part:
    vertices = _array(arrays, f"{k}.vertices", np.float32, None, 3)
    normals = _array(arrays, f"{k}.normals", np.float32, len(vertices), 3)
    faces = _array(arrays, f"{k}.faces", np.int32, None, 3)
    color = _array(arrays, f"{k}.color", np.float32, 4)
    if faces.min() < 0 or faces.max() >= len(vertices) or len(vertices) > faces.size:
        raise ValueError(f"{k}.faces name other vertices than there are")
    for name, values, most in (("vertices", vertices, FIT_RADIUS), ("normals", normals, 1.0)):
        if float(np.square(values, dtype=np.float64).sum(axis=1).max()) > (most * _ROUNDING) ** 2:
            raise ValueError(f"{k}.{name} are longer than {most:g}")
    if color.min() < 0 or color.max() > 1:
        raise ValueError(f"{k}.color is not in [0,1]")
    return Part(
        vertices=vertices,
        normals=normals,
        faces=faces,
        uv=_array(arrays, f"{k}.uv", np.float32, len(vertices), 2) if record.uv else None,
        color=color,
        texture=None if record.texels is None else _texture(textures, record.texels),
        metallic_roughness=None if record.material is None else _material(arrays, k, record.material, textures),
    )


def _material_record(material: MetallicRoughness, texels: Callable[[NDArray[Any]], int]) -> _Material:
    fields = {name: getattr(material, name) for name in _Material.model_fields if name not in ("maps", "emissive")}
    maps = {
        name: _Map.model_validate({"texels": texels(one.texels), "uv_set": one.uv_set, "wrap": list(one.wrap)})
        for name, one in material.maps.items()
    }
    return _Material(**fields, emissive=list(material.emissive), maps=maps)


def _material(arrays: Arrays, k: int, record: _Material, textures: list[NDArray[Any]]) -> MetallicRoughness:
    count = len(arrays[f"{k}.vertices"])
    fields = {name: getattr(record, name) for name in _Material.model_fields if name not in ("maps", "emissive")}
    attributes: dict[str, Any] = {
        name: _array(arrays, f"{k}.{name}", np.float32, count, width) for name, width in _ATTRIBUTES.items()
    }
    red, green, blue = record.emissive
    maps = {
        name: TextureMap(_texture(textures, one.texels), one.uv_set, (one.wrap[0], one.wrap[1]))
        for name, one in record.maps.items()
    }
    return MetallicRoughness(**fields, **attributes, emissive=(red, green, blue), maps=maps)


def _texture(textures: list[NDArray[Any]], number: int) -> NDArray[Any]:
    if number >= len(textures):
        raise ValueError(f"there is no texels.{number}")
    return textures[number]
