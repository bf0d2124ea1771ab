"""Textures on a square: every texel's place and linear colour is known."""

from math import tan

import numpy as np

from services.accuracy.placing import placed
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.definition import displayed
from services.accuracy.stability.glb import file_of, square_arrays
from services.accuracy.stability.lamps import EXPOSURE, Lamps, radiance
from services.accuracy.stability.shapes import square
from services.accuracy.stability.views import drawn_by
from services.rendering.opengl.gbuffer import rasterise
from services.scenes.mesh import FIT_RADIUS, Bytes, Doubles, Part
from services.scenes.reading import read_mesh

SIZE = 48
"""Pixels a side of the images."""

TEXEL = 2e-3
"""Error of a linear colour: half a step of 8 bits, for drivers decode sRGB by a polynomial (llvmpipe's is off by
1.2e-3)."""

CORNERS = np.array([[(210, 40, 90), (20, 180, 120)], [(60, 70, 220), (235, 205, 30)]], np.uint8)
"""sRGB bytes of a texture's quarters, as an image shows them: upper left, upper right; lower left, lower right."""


def quartered(side: int = 32) -> Bytes:
    """A texture of four quarters, [side, side, 4], opaque."""
    color = CORNERS.repeat(side // 2, axis=0).repeat(side // 2, axis=1)
    return np.concatenate([color, np.full((side, side, 1), 255, np.uint8)], axis=2)


def decoded(values: "Bytes | list[int]") -> Doubles:
    """Linear colours of sRGB bytes (IEC 61966-2-1)."""
    shown = np.asarray(values, np.float64) / 255
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def _seen(
    parts: tuple[Part, ...], side: float, points: list[tuple[float, float]], wanted: Doubles, plain: bool = True
) -> Measured:
    """The linear base colours `wanted` [N, 3] at points of the square, from (0, 0) at its upper left to (1, 1).

    In the G-buffer as they are; of a `plain` surface in pyrender's image under the sky alone, too (a file's surface is
    shaded as glTF says, by another formula). Under a coloured factor, which counts.
    """
    factor = np.array([1.0, 0.6, 0.3])
    scene = placed(
        parts,
        size=(SIZE, SIZE),
        camera={"azimuth": 0.0, "elevation": 0.0},
        thing={"color": tuple(factor)},
        lights={"ambient": 0.9, "points": []},
    )
    focal = SIZE / 2 / tan(scene.description.camera.field_of_view / 2)
    across = np.array(points) - 0.5
    # The pixel in which the point lies; the square's plane holds the origin.
    columns, rows = (SIZE / 2 + focal * side / scene.description.camera.distance * across).astype(int).T
    colors = wanted * factor
    gbuffer = rasterise(scene).base_color[rows, columns].double().numpy()
    worst = float(np.abs(gbuffer - colors).max())
    x, y = ((columns + 0.5) / SIZE * 2 - 1), (1 - (rows + 0.5) / SIZE * 2)
    reach = tan(scene.description.camera.field_of_view / 2) * scene.description.camera.distance
    positions = np.stack([x * reach, y * reach, 0 * x], axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    shown = displayed(EXPOSURE * radiance(positions, normals, colors, scene.view[:3, 3], Lamps(0.9)))
    for renderer in drawn_by(scene, "pyrender") if plain else ():
        image = renderer.render({})[0][rows, columns].double().numpy()
        worst = max(worst, float(np.abs(image - shown).max()))
    return Measured(worst, TEXEL, "largest error of a linear base colour and of a displayed value")


def _quarters(repeats: int) -> Measured:
    """The middle of each quarter of each repetition."""
    cells = 2 * repeats
    points = [((j + 0.5) / cells, (i + 0.5) / cells) for i in range(cells) for j in range(cells)]
    wanted = decoded(np.tile(CORNERS, (repeats, repeats, 1)).reshape(-1, 3))
    return _seen(square(0.8, quartered(), repeats), 0.8, points, wanted)


def _averaged() -> Measured:
    """A board of black and white texels smaller than a pixel is half as bright as white, in linear light."""
    board = np.zeros((512, 512, 4), np.uint8)
    board[..., 3] = 255
    board[::2, ::2, :3] = board[1::2, 1::2, :3] = 255
    points = [(x, y) for x in (0.2, 0.5, 0.8) for y in (0.3, 0.7)]
    scene = placed(square(0.8, board), size=(SIZE, SIZE), camera={"azimuth": 0.0, "elevation": 0.0})
    focal = SIZE / 2 / tan(scene.description.camera.field_of_view / 2)
    columns, rows = (SIZE / 2 + focal * 0.8 / 1.8 * (np.array(points) - 0.5)).astype(int).T
    seen = rasterise(scene).base_color[rows, columns].double().numpy()
    # Each level of the texture is rounded to 8 bits, in which half a linear 1 is 188.
    return Measured(float(np.abs(seen - 0.5).max()), 0.01, "distance of the base colour from 0.5, closed form")


def _holes() -> Measured:
    """Where alpha is 0 the square is not there: its upper left quarter."""
    texture = quartered()
    texture[:16, :16, 3] = 0
    scene = placed(square(0.8, texture), size=(SIZE, SIZE), camera={"azimuth": 0.0, "elevation": 0.0})
    focal = SIZE / 2 / tan(scene.description.camera.field_of_view / 2)
    extent = focal * 0.8 / 1.8
    coverage = rasterise(scene).coverage.double().numpy() / extent**2
    ground = np.array(scene.description.ground)
    hole = slice(int(24 - 0.4 * extent), int(24 - 0.1 * extent))
    for renderer in drawn_by(scene, "pyrender"):
        image = renderer.render({})[0].double().numpy()
        need(float(np.abs(image[hole, hole] - ground).max()) < 1e-7, "the ground does not show through the hole")
    shares = np.array([coverage[:24, :24].sum(), coverage[:24, 24:].sum(), coverage[24:].sum()])
    off = float(np.abs(shares - (0.0, 0.25, 0.5)).max())
    return Measured(off, 0.01, "error of a quarter's share of the square's area, closed form")


def _file() -> Measured:
    """The same square from a file, fitted to the frame: half its diagonal is FIT_RADIUS."""
    surface = {"baseColorTexture": quartered(), "metallicFactor": 0.0, "roughnessFactor": 0.45}
    parts = read_mesh(file_of(square_arrays(), {"pbrMetallicRoughness": surface}), "glb", 10)
    points = [(x, y) for y in (0.25, 0.75) for x in (0.25, 0.75)]
    return _seen(parts, FIT_RADIUS * 2**0.5, points, decoded(CORNERS.reshape(-1, 3)), plain=False)


def cases() -> list[Case]:
    """The cases of this family."""
    family, known = "textures", "each quarter where it must be, in its linear colour"
    return [
        Case("four quarters", family, "colours of every channel, a factor", known, lambda: _quarters(1)),
        Case("repeated three times", family, "uv up to 3", known, lambda: _quarters(3)),
        Case("four quarters from a file", family, "glTF: v runs down", known, _file),
        Case("texels smaller than a pixel", family, "512² black and white on 24 pixels", "half the light", _averaged),
        Case("a quarter cut out", family, "alpha 0", "the ground shows through it", _holes),
    ]
