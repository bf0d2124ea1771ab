"""Meshes as nobody would make them on purpose, and as they are found."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import torch
import trimesh

from services.accuracy.placing import placed, sky
from services.accuracy.stability.case import Case, Measured, need
from services.accuracy.stability.views import against_rays, sound
from services.rendering.factory import build
from services.scenes.mesh import Doubles, Longs, Part
from services.scenes.reading import read_mesh
from services.settings import DEFAULTS

SAME = 2e-6
"""Images of one solid from two files: float32 vertices move a value by less (measured: 1.2e-7)."""

Triangles = tuple[Doubles, Longs]
"""Vertices [V, 3] and faces [F, 3]."""


def as_obj(vertices: Doubles, faces: Longs) -> bytes:
    """An OBJ file, with every digit of a float64."""
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


def _same(change: Callable[[Doubles, Longs], Triangles], kind: str = "obj", limit: float = SAME) -> Measured:
    """The image of the changed mesh against that of the solid as it was."""
    write = as_obj if kind == "obj" else as_stl
    faces = DEFAULTS.max_faces
    plain, changed = read_mesh(as_obj(*_solid()), "obj", faces), read_mesh(write(*change(*_solid())), kind, faces)
    first, second = _shown(plain), _shown(changed)
    need(float(first.std()) > 0.05, "the image shows nothing")
    return Measured(
        float((first - second).abs().max()), limit, "largest difference of a displayed value from the sound mesh"
    )


def _with_degenerate(vertices: Doubles, faces: Longs) -> Triangles:
    """Points, needles and folded-over triangles between the good ones."""
    n, (a, b, _) = len(vertices), faces.T
    more = np.concatenate([vertices, (vertices[a] + vertices[b]) / 2])
    middle = n + np.arange(len(faces))
    bad = [np.stack([a, a, a], 1), np.stack([a, b, a], 1), np.stack([a, middle, b], 1)]
    return more, np.concatenate([faces, *bad])


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
    limit, front = DEFAULTS.max_faces, {"azimuth": 0.0, "elevation": 0.0}
    # From +z; a little less than half is seen, nothing of the missing band.
    first, second = (_shown(read_mesh(as_obj(vertices, f), "obj", limit), front) for f in (faces, torn))
    return Measured(
        float((first - second).abs().max()), SAME, "largest difference of a displayed value from the whole sphere"
    )


def _rounded(count: int) -> Measured:
    """A sphere of very many triangles has the normals of a sphere."""
    ball = trimesh.creation.uv_sphere(count=[int((count / 4) ** 0.5) + 2] * 2)
    parts = read_mesh(as_stl(np.asarray(ball.vertices), np.asarray(ball.faces)), "stl", DEFAULTS.max_faces)
    need(sum(len(part.faces) for part in parts) > 0.95 * len(ball.faces), "triangles were lost")
    need(len(ball.faces) >= count, f"only {len(ball.faces):,} triangles")
    scene = placed(parts, size=(64, 64))
    seen = sound(scene)
    points = parts[0].vertices.astype(np.float64)
    wanted = points / np.linalg.norm(points, axis=1, keepdims=True)
    error = np.linalg.norm(parts[0].normals - wanted, axis=1)
    need(float(seen.coverage.max()) == 1, "it is not seen")
    return Measured(float(error.max()), 2e-3, "largest distance of a vertex normal from the sphere's")


def _read(vertices: Doubles, faces: Longs, limit: int | None = None) -> Measured:
    parts = read_mesh(as_obj(vertices, faces), "obj", limit or DEFAULTS.max_faces)
    return Measured(float(len(parts)), 0.0, "parts read")


def _triangle() -> Measured:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1, 0.2]], np.float64)
    return against_rays(placed(read_mesh(as_obj(corners, np.array([[0, 1, 2]])), "obj", 10), size=(24, 24)))


def _moved(by: float) -> Callable[[Doubles, Longs], Triangles]:
    return lambda v, f: (v + by, f)


def _scaled(by: float) -> Callable[[Doubles, Longs], Triangles]:
    return lambda v, f: (v * by, f)


def cases() -> list[Case]:
    """The cases of this family."""
    family, same, refused = "meshes", "the image of the sound mesh", "a clear error names the file"
    v, f = _solid()
    nan, inf = v.copy(), v.copy()
    nan[5, 1], inf[7, 2] = float("nan"), float("inf")
    rays = "coverage, depth, normals and colours as rays have them"
    return [
        Case(
            "degenerate triangles",
            family,
            "points, needles, folds: three for each good one",
            same,
            lambda: _same(_with_degenerate),
        ),
        Case(
            "duplicate triangles",
            family,
            "every triangle four times, two of them inside out",
            same,
            lambda: _same(lambda v, f: (v, np.concatenate([f, f[:, [1, 2, 0]], f[:, ::-1], f[:, [1, 0, 2]]]))),
        ),
        Case("inside out", family, "every winding inverted", same, lambda: _same(lambda v, f: (v, f[:, ::-1]))),
        Case("partly inside out", family, "a third of the windings inverted", same, lambda: _same(_half_turned)),
        Case("unwelded", family, "no two triangles share a vertex", same, lambda: _same(lambda v, f: (v, f), "stl")),
        Case("shuffled", family, "the order of vertices and triangles", same, lambda: _same(_shuffled)),
        Case("torn open", family, "not watertight", "the hidden hole is not seen", _open),
        Case("1e-6 in size", family, "areas of 1e-15", same, lambda: _same(_scaled(1e-6))),
        Case("1e-20 in size", family, "areas of 1e-43", same, lambda: _same(_scaled(1e-20))),
        Case("1e6 in size", family, "areas of 1e9", same, lambda: _same(_scaled(1e6))),
        Case("1e20 in size", family, "squares beyond float32", same, lambda: _same(_scaled(1e20))),
        Case("1e6 from the origin", family, "float32 has 0.06 left of a size of 1", same, lambda: _same(_moved(1e6))),
        Case("20k triangles", family, "with needles at the poles", "the normals of a sphere", lambda: _rounded(20_000)),
        Case(
            "200k triangles",
            family,
            "with needles at the poles",
            "the normals of a sphere",
            lambda: _rounded(200_000),
            slow=True,
        ),
        Case("one triangle", family, "no volume, no neighbours", rays, _triangle),
        Case(
            "a chair as it is found",
            family,
            "furniture of many parts, unwelded, open",
            rays,
            lambda: against_rays(placed("furniture/chair", size=(16, 16))),
        ),
        Case("NaN vertex", family, "not a number", refused, lambda: _read(nan, f), "refused", "file"),
        Case("infinite vertex", family, "not a number", refused, lambda: _read(inf, f), "refused", "file"),
        Case(
            "coordinates of 1e31",
            family,
            "squares beyond any float",
            refused,
            lambda: _read(v * 1e31, f),
            "refused",
            "file",
        ),
        Case("all at one point", family, "no extent", refused, lambda: _read(v * 0 + 1, f), "refused", "file"),
        Case(
            "all on one line",
            family,
            "extent, but no area",
            refused,
            lambda: _read(v * (1, 0, 0), f),
            "refused",
            "file",
        ),
        Case(
            "too many triangles",
            family,
            "one more than are taken",
            refused,
            lambda: _read(v, f, len(f) - 1),
            "refused",
            "file",
        ),
    ]
