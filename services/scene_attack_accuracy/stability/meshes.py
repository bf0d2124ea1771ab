"""Meshes with defects that occur in practice, and textures whose every texel is known."""

from collections.abc import Callable, Iterator
from functools import lru_cache
from math import tan
from typing import Any

import numpy as np
import torch
import trimesh

from scene_attack.options import DEFAULTS
from scene_attack.rendering.factory import build
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.scenes.mesh import FIT_RADIUS, Bytes, Doubles, Longs, Part
from scene_attack.scenes.reading.formats import read_mesh
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack_accuracy.placing import placed, sky
from scene_attack_accuracy.stability.case import Case, Measured, case, largest, need
from scene_attack_accuracy.stability.geometry import FRONT, against_rays, drawn_by, sound
from scene_attack_accuracy.stability.gltf_file import file_of
from scene_attack_accuracy.stability.objects import square, square_arrays
from scene_attack_accuracy.stability.references import EXPOSURE, Lamps, displayed, radiance

SAME = 2e-6
"""Images of one solid from two files: float32 vertices move a value by less (measured: 1.2e-7)."""

Triangles = tuple[Doubles, Longs]
"""Vertices [V, 3] and faces [F, 3]."""


def as_obj(vertices: Doubles, faces: Longs) -> bytes:
    """Returns an OBJ file with every digit of a float64."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    return "\n".join(lines).encode()


def as_stl(vertices: Doubles, faces: Longs) -> bytes:
    """A binary STL file: every triangle has its own corners, in float32."""
    data: bytes = trimesh.Trimesh(vertices, faces, process=False).export(file_type="stl")
    return data


@lru_cache(maxsize=1)
def _solid() -> Triangles:
    """A torus, not symmetric in any axis: it is squeezed and turned."""
    torus = trimesh.creation.torus(1.0, 0.4, major_sections=48, minor_sections=24)
    turn = trimesh.transformations.rotation_matrix(0.9, [1.0, 0.5, 0.2])[:3, :3]
    return np.asarray(torus.vertices) @ turn.T * (1.0, 0.8, 0.9), np.asarray(torus.faces, np.int64)


def _shown(parts: tuple[Part, ...], camera: dict[str, float] | None = None) -> torch.Tensor:
    scene = placed(parts, size=(32, 32), radiance=sky(), camera=camera)
    sound(scene)
    with torch.no_grad():
        image = build(scene, "torch").exact().render({})[0]
    need(bool(torch.isfinite(image).all()), "the image has values that are not finite")
    return image


def _same(change: Callable[[Doubles, Longs], Triangles], kind: str = "obj") -> Measured:
    """Compares the image of the changed mesh with that of the original solid."""
    write = as_obj if kind == "obj" else as_stl
    faces = DEFAULTS.max_faces
    plain, changed = read_mesh(as_obj(*_solid()), "obj", faces), read_mesh(write(*change(*_solid())), kind, faces)
    first, second = _shown(plain), _shown(changed)
    need(float(first.std()) > 0.05, "the image shows nothing")
    return Measured(largest(first - second), SAME, "largest difference of a displayed value from the sound mesh")


def _with_degenerate(vertices: Doubles, faces: Longs) -> Triangles:
    """Points, needles and folded-over triangles between the good ones."""
    n, (a, b, _) = len(vertices), faces.T
    more = np.concatenate([vertices, (vertices[a] + vertices[b]) / 2])
    middle = n + np.arange(len(faces))
    bad = [np.stack([a, a, a], 1), np.stack([a, b, a], 1), np.stack([a, middle, b], 1)]
    return more, np.concatenate([faces, *bad])


def _repeated(vertices: Doubles, faces: Longs) -> Triangles:
    """Every triangle four times, two of them inside out."""
    return vertices, np.concatenate([faces, faces[:, [1, 2, 0]], faces[:, ::-1], faces[:, [1, 0, 2]]])


def _half_turned(vertices: Doubles, faces: Longs) -> Triangles:
    """A third of the faces, at random, wound the wrong way."""
    turned = faces.copy()
    wrong = np.random.default_rng(1).random(len(faces)) < 0.33
    turned[wrong] = turned[wrong][:, ::-1]
    return vertices, turned


def _shuffled(vertices: Doubles, faces: Longs) -> Triangles:
    """The same triangles in another order, vertices renumbered."""
    random = np.random.default_rng(2)
    order = random.permutation(len(vertices))
    place = np.argsort(order)
    return vertices[order], place[faces][random.permutation(len(faces))]


def _open() -> Measured:
    """A sphere with its hidden side torn open looks as if it were whole."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, np.int64)
    height = vertices[faces][:, :, 2].mean(axis=1)
    # What reaches furthest along each axis stays, so that the sphere is fitted to the frame as before.
    torn = faces[(height > -0.3) | (height < -0.9)]
    need(len(torn) < len(faces) * 0.8, "hardly anything is missing")
    limit = DEFAULTS.max_faces
    # From +z; a little less than half is seen, nothing of the missing band.
    first, second = (_shown(read_mesh(as_obj(vertices, f), "obj", limit), FRONT) for f in (faces, torn))
    return Measured(largest(first - second), SAME, "largest difference of a displayed value from the whole sphere")


def _rounded(count: int) -> Measured:
    """A sphere of very many triangles has the normals of a sphere."""
    ball = trimesh.creation.uv_sphere(count=[int((count / 4) ** 0.5) + 2] * 2)
    parts = read_mesh(as_stl(np.asarray(ball.vertices), np.asarray(ball.faces)), "stl", DEFAULTS.max_faces)
    need(sum(len(part.faces) for part in parts) > 0.95 * len(ball.faces), "triangles were lost")
    need(len(ball.faces) >= count, f"only {len(ball.faces):,} triangles")
    scene = placed(parts, size=(64, 64))
    seen = sound(scene)
    points = parts[0].vertices.astype(np.float64)
    reference = points / np.linalg.norm(points, axis=1, keepdims=True)
    error = np.linalg.norm(parts[0].normals - reference, axis=1)
    need(float(seen.coverage.max()) == 1, "it is not seen")
    return Measured(float(error.max()), 2e-3, "largest distance of a vertex normal from the sphere's")


def _read(vertices: Doubles, faces: Longs, limit: int | None = None) -> Measured:
    parts = read_mesh(as_obj(vertices, faces), "obj", limit or DEFAULTS.max_faces)
    return Measured(float(len(parts)), 0.0, "parts read")


def _triangle() -> Measured:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1, 0.2]], np.float64)
    return against_rays(placed(read_mesh(as_obj(corners, np.array([[0, 1, 2]])), "obj", 10), size=(24, 24)))


def _chair() -> Measured:
    return against_rays(placed("furniture/chair", size=(16, 16)))


def _moved(by: float) -> Callable[[Doubles, Longs], Triangles]:
    return lambda v, f: (v + by, f)


def _scaled(by: float) -> Callable[[Doubles, Longs], Triangles]:
    return lambda v, f: (v * by, f)


def mesh_cases() -> Iterator[Case]:
    """The cases of this family."""
    same, refused = "the image of the sound mesh", "a clear error names the file"
    v, f = _solid()
    nan, inf = v.copy(), v.copy()
    nan[5, 1], inf[7, 2] = float("nan"), float("inf")
    rays = "coverage, depth, normals and colours as rays have them"
    yield case("degenerate triangles", "points, needles, folds: three for each good one", same, _same, _with_degenerate)
    copies = "every triangle four times, two of them inside out"
    yield case("duplicate triangles", copies, same, _same, _repeated)
    yield case("inside out", "every winding inverted", same, _same, lambda v, f: (v, f[:, ::-1]))
    yield case("partly inside out", "a third of the windings inverted", same, _same, _half_turned)
    yield case("unwelded", "no two triangles share a vertex", same, _same, lambda v, f: (v, f), "stl")
    yield case("shuffled", "the order of vertices and triangles", same, _same, _shuffled)
    yield case("torn open", "not watertight", "the hidden hole is not seen", _open)
    yield case("1e-6 in size", "areas of 1e-15", same, _same, _scaled(1e-6))
    yield case("1e-20 in size", "areas of 1e-43", same, _same, _scaled(1e-20))
    yield case("1e6 in size", "areas of 1e9", same, _same, _scaled(1e6))
    yield case("1e20 in size", "squares beyond float32", same, _same, _scaled(1e20))
    yield case("1e6 from the origin", "float32 has 0.06 left of a size of 1", same, _same, _moved(1e6))
    yield case("20k triangles", "with needles at the poles", "the normals of a sphere", _rounded, 20_000)
    yield case("200k triangles", "with needles at the poles", "the normals of a sphere", _rounded, 200_000, slow=True)
    yield case("one triangle", "no volume, no neighbours", rays, _triangle)
    yield case("a chair as it is found", "furniture of many parts, unwelded, open", rays, _chair)
    yield case("NaN vertex", "not a number", refused, _read, nan, f, refusal="file")
    yield case("infinite vertex", "not a number", refused, _read, inf, f, refusal="file")
    yield case("coordinates of 1e31", "squares beyond any float", refused, _read, v * 1e31, f, refusal="file")
    yield case("all at one point", "no extent", refused, _read, v * 0 + 1, f, refusal="file")
    yield case("all on one line", "extent, but no area", refused, _read, v * (1, 0, 0), f, refusal="file")
    yield case("too many triangles", "one more than are taken", refused, _read, v, f, len(f) - 1, refusal="file")


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


def _square_scene(parts: tuple[Part, ...], **options: Any) -> tuple[ResolvedScene, float]:
    """The square straight before the camera, and the pixels of a scene unit at its distance."""
    scene = placed(parts, size=(SIZE, SIZE), camera=FRONT, **options)
    camera = scene.description.camera
    return scene, SIZE / 2 / tan(camera.field_of_view / 2) / camera.distance


def _seen(
    parts: tuple[Part, ...], side: float, points: list[tuple[float, float]], reference: Doubles, plain: bool = True
) -> Measured:
    """The linear base colours `reference` [N, 3] at points of the square, from (0, 0) at its upper left to (1, 1).

    They are compared under a coloured factor: with the G-buffer and, for a `plain` surface, with pyrender's image under
    the sky alone too (a file's surface is shaded by glTF's formula, which differs).
    """
    factor = np.array([1.0, 0.6, 0.3])
    lights = {"ambient": 0.9, "points": []}
    scene, scale = _square_scene(parts, thing={"color": tuple(factor)}, lights=lights)
    across = np.array(points) - 0.5
    # The pixel in which the point lies; the square's plane holds the origin.
    columns, rows = (SIZE / 2 + scale * side * across).astype(int).T
    colors = reference * factor
    gbuffer = rasterise(scene).base_color[rows, columns].double().numpy()
    worst = largest(gbuffer - colors)
    x, y = ((columns + 0.5) / SIZE * 2 - 1), (1 - (rows + 0.5) / SIZE * 2)
    reach = SIZE / 2 / scale
    positions = np.stack([x * reach, y * reach, 0 * x], axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    shown = displayed(EXPOSURE * radiance(positions, normals, colors, scene.view[:3, 3], Lamps(0.9)))
    for renderer in drawn_by(scene, "pyrender") if plain else ():
        image = renderer.render({})[0][rows, columns].double().numpy()
        worst = max(worst, largest(image - shown))
    return Measured(worst, TEXEL, "largest error of a linear base colour and of a displayed value")


def _quarters(repeats: int) -> Measured:
    """Compares the middle of each quarter of each repetition."""
    cells = 2 * repeats
    points = [((j + 0.5) / cells, (i + 0.5) / cells) for i in range(cells) for j in range(cells)]
    reference = decoded(np.tile(CORNERS, (repeats, repeats, 1)).reshape(-1, 3))
    return _seen(square(0.8, quartered(), repeats), 0.8, points, reference)


def _averaged() -> Measured:
    """A board of black and white texels smaller than a pixel is half as bright as white, in linear light."""
    board = np.zeros((512, 512, 4), np.uint8)
    board[..., 3] = 255
    board[::2, ::2, :3] = board[1::2, 1::2, :3] = 255
    points = [(x, y) for x in (0.2, 0.5, 0.8) for y in (0.3, 0.7)]
    scene, scale = _square_scene(square(0.8, board))
    columns, rows = (SIZE / 2 + scale * 0.8 * (np.array(points) - 0.5)).astype(int).T
    seen = rasterise(scene).base_color[rows, columns].double().numpy()
    # Each level of the texture is rounded to 8 bits, in which half a linear 1 is 188.
    return Measured(largest(seen - 0.5), 0.01, "distance of the base colour from 0.5, closed form")


def _holes() -> Measured:
    """The square is invisible in its upper left quarter, whose alpha is 0."""
    texture = quartered()
    texture[:16, :16, 3] = 0
    scene, scale = _square_scene(square(0.8, texture))
    extent = 0.8 * scale
    coverage = rasterise(scene).coverage.double().numpy() / extent**2
    ground = np.array(scene.description.ground)
    hole = slice(int(24 - 0.4 * extent), int(24 - 0.1 * extent))
    for renderer in drawn_by(scene, "pyrender"):
        image = renderer.render({})[0].double().numpy()
        need(largest(image[hole, hole] - ground) < 1e-7, "the ground does not show through the hole")
    shares = np.array([coverage[:24, :24].sum(), coverage[:24, 24:].sum(), coverage[24:].sum()])
    off = largest(shares - (0.0, 0.25, 0.5))
    return Measured(off, 0.01, "error of a quarter's share of the square's area, closed form")


def _file() -> Measured:
    """The same square from a file, fitted to the frame: half its diagonal is FIT_RADIUS."""
    surface = {"baseColorTexture": quartered(), "metallicFactor": 0.0, "roughnessFactor": 0.45}
    parts = read_mesh(file_of(square_arrays(), {"pbrMetallicRoughness": surface}), "glb", 10)
    points = [(x, y) for y in (0.25, 0.75) for x in (0.25, 0.75)]
    return _seen(parts, FIT_RADIUS * 2**0.5, points, decoded(CORNERS.reshape(-1, 3)), plain=False)


def texture_cases() -> Iterator[Case]:
    """The cases of this family."""
    known = "each quarter where it must be, in its linear colour"
    yield case("four quarters", "colours of every channel, a factor", known, _quarters, 1)
    yield case("repeated three times", "uv up to 3", known, _quarters, 3)
    yield case("four quarters from a file", "glTF: v runs down", known, _file)
    yield case("texels smaller than a pixel", "512² black and white on 24 pixels", "half the light", _averaged)
    yield case("a quarter cut out", "alpha 0", "the ground shows through it", _holes)
