"""Ten small glTF models, one for each input of a metallic-roughness material, written byte by byte."""

from collections.abc import Callable
from math import cos, pi, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scene_attack_accuracy.stability.gltf_file import Arrays, Writer


def sphere(radius: float = 1.0, rings: int = 48) -> Arrays:
    """A sphere with normals and texture coordinates, v downwards."""
    theta, phi = np.meshgrid(np.linspace(0, pi, rings + 1), np.linspace(0, 2 * pi, 2 * rings + 1), indexing="ij")
    normals = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1).reshape(-1, 3)
    first = (np.arange(rings)[:, None] * (2 * rings + 1) + np.arange(2 * rings)).reshape(-1, 1)
    below = first + 2 * rings + 1
    faces = np.vstack([np.hstack([first, below, first + 1]), np.hstack([first + 1, below, below + 1])])
    uv = np.stack([phi / (2 * pi), theta / pi], -1).reshape(-1, 2)
    return {"POSITION": normals * radius, "NORMAL": normals, "TEXCOORD_0": uv, "indices": faces.ravel()}


def checks(first: tuple[int, ...], second: tuple[int, ...], squares: int = 8, side: int = 32) -> NDArray[np.uint8]:
    """A chessboard of two colours."""
    row, column = np.indices((squares * side, squares * side)) // side
    board: NDArray[np.uint8] = np.where(((row + column) % 2)[..., None] == 0, first, second).astype(np.uint8)
    return board


def bumps(waves: int = 6, height: float = 0.5, side: int = 256) -> NDArray[np.uint8]:
    """The normal map of a sine in both directions."""
    turn = (np.arange(side) + 0.5) / side * 2 * pi * waves
    x, y = np.meshgrid(height * np.cos(turn), height * np.sin(turn))
    normal = np.stack([x, y, np.ones_like(x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    encoded: NDArray[np.uint8] = np.rint(127.5 + 127.5 * normal).astype(np.uint8)
    return encoded


def _surface(color: tuple[float, ...], metallic: float, roughness: float, **more: Any) -> dict[str, Any]:
    return {"baseColorFactor": [*color, 1.0][:4], "metallicFactor": metallic, "roughnessFactor": roughness, **more}


def _ball(make: Callable[[Writer], dict[str, Any]], **arrays: NDArray[Any]) -> bytes:
    writer = Writer()
    writer.root(mesh=writer.mesh(writer.primitive(sphere() | arrays, make(writer))))
    return writer.glb()


def metallic() -> bytes:
    """Gold, fairly smooth."""
    return _ball(lambda _: {"pbrMetallicRoughness": _surface((0.9, 0.6, 0.2), 1.0, 0.4)})


def rough() -> bytes:
    """A dielectric whose roughness changes from square to square."""

    def make(writer: Writer) -> dict[str, Any]:
        texture = writer.texture(checks((0, 64, 0), (0, 255, 0)))
        return {"pbrMetallicRoughness": _surface((0.7, 0.2, 0.2), 1.0, 1.0, metallicRoughnessTexture=texture)}

    return _ball(make)


def emissive() -> bytes:
    """A dark ball with glowing squares."""

    def make(writer: Writer) -> dict[str, Any]:
        texture = writer.texture(checks((255, 160, 60), (0, 0, 0)))
        surface = _surface((0.2, 0.2, 0.2), 0.0, 0.8)
        return {"pbrMetallicRoughness": surface, "emissiveFactor": [0.9, 0.5, 0.5], "emissiveTexture": texture}

    return _ball(make)


def normal_mapped() -> bytes:
    """Bumps, without tangents in the file."""

    def make(writer: Writer) -> dict[str, Any]:
        return {
            "pbrMetallicRoughness": _surface((0.6, 0.6, 0.7), 0.0, 0.6),
            "normalTexture": writer.texture(bumps()),
        }

    return _ball(make)


def masked() -> bytes:
    """Squares cut out, and the inside seen through the holes."""

    def make(writer: Writer) -> dict[str, Any]:
        texture = writer.texture(checks((60, 180, 90, 255), (60, 180, 90, 40)))
        surface = _surface((1.0, 1.0, 1.0), 0.0, 0.7, baseColorTexture=texture)
        return {"pbrMetallicRoughness": surface, "alphaMode": "MASK", "alphaCutoff": 0.4, "doubleSided": True}

    return _ball(make)


def blended() -> bytes:
    """Squares of two opacities, seen from outside only."""

    def make(writer: Writer) -> dict[str, Any]:
        texture = writer.texture(checks((90, 120, 220, 230), (90, 120, 220, 100)))
        surface = _surface((1.0, 1.0, 1.0, 0.8), 0.0, 0.7, baseColorTexture=texture)
        return {"pbrMetallicRoughness": surface, "alphaMode": "BLEND"}

    return _ball(make)


def vertex_coloured() -> bytes:
    """Colours that change from pole to pole."""
    height = sphere()["POSITION"][:, 1:2] / 2 + 0.5
    colors = np.hstack([height, 1 - height, 0 * height + 0.3, 0 * height + 1])
    return _ball(lambda _: {"pbrMetallicRoughness": _surface((0.8, 0.8, 0.8), 0.0, 0.7)}, COLOR_0=colors)


def nested_transforms() -> bytes:
    """Three nodes with the same mesh: translated and scaled, rotated within the first, and mirrored by a matrix."""
    writer = Writer()
    ball = writer.mesh(
        writer.primitive(sphere(0.5), {"pbrMetallicRoughness": _surface((0.8, 0.5, 0.3), 0.0, 0.5)}),
    )
    turned = writer.add("nodes", {"mesh": ball, "rotation": [0, 0, sin(pi / 8), cos(pi / 8)], "scale": [1, 2, 1]})
    moved = writer.add("nodes", {"children": [turned], "translation": [1.2, 0, 0], "scale": [0.8, 0.6, 1]})
    mirror = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -1.1, 0.2, 0, 1]
    mirrored = writer.add("nodes", {"mesh": ball, "matrix": mirror})
    writer.root(mesh=ball, children=[moved, mirrored], rotation=[0, sin(pi / 12), 0, cos(pi / 12)])
    return writer.glb()


def two_materials() -> bytes:
    """The halves of a ball: a rough metal above, a dielectric below."""
    writer = Writer()
    ball = sphere()
    corners = ball["indices"].reshape(-1, 3)
    above = ball["POSITION"][corners].mean(axis=1)[:, 1] > 0
    materials = _surface((0.7, 0.7, 0.75), 1.0, 0.6), _surface((0.1, 0.3, 0.6), 0.0, 0.4)
    halves = [
        writer.primitive(ball | {"indices": corners[chosen].ravel()}, {"pbrMetallicRoughness": surface})
        for chosen, surface in zip((above, ~above), materials, strict=True)
    ]
    writer.root(mesh=writer.mesh(*halves))
    return writer.glb()


def two_uv_sets(baked: bool = False) -> bytes:
    """Base colour along the first set of texture coordinates, metal along the second; `baked`: the same, with the metal
    laid out along the first."""
    board = checks((0, 128, 255), (0, 128, 0))
    half = np.ascontiguousarray(np.repeat(board[: len(board) // 2], 2, axis=0).transpose(1, 0, 2))

    def make(writer: Writer) -> dict[str, Any]:
        colors = writer.texture(checks((220, 90, 60), (240, 220, 180)))
        metal = writer.texture(half) if baked else writer.texture(board, texCoord=1)
        surface = _surface((1, 1, 1), 1.0, 1.0, baseColorTexture=colors, metallicRoughnessTexture=metal)
        return {"pbrMetallicRoughness": surface}

    return _ball(make, TEXCOORD_1=sphere()["TEXCOORD_0"][:, ::-1] * (1, 0.5))


MODELS: dict[str, Callable[[], bytes]] = {
    "metallic": metallic,
    "rough": rough,
    "emissive": emissive,
    "normal-mapped": normal_mapped,
    "masked": masked,
    "blended": blended,
    "vertex-coloured": vertex_coloured,
    "nested transforms": nested_transforms,
    "two materials": two_materials,
    "two UV sets": two_uv_sets,
}
