"""Which meshes count as convex: closed ones without a dent."""

import numpy as np
import pytest

from scene_attack.scenes.mesh import Mesh, Part
from scene_attack.scenes.primitives import primitive
from scene_attack.scenes.solids import is_convex


def mesh(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    normals = np.tile(np.array([0, 1, 0], np.float32), (len(vertices), 1))
    return Mesh((Part(vertices.astype(np.float32), normals, faces.astype(np.int32)),), "", None)


def ball(rows: int = 12, columns: int = 16, dent: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points on a grid of angles; the one in the middle is pushed in by `dent`."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, rows), np.arange(columns) * 2 * np.pi / columns, indexing="ij")
    points = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1)
    points[0], points[-1] = (0, 1, 0), (0, -1, 0)
    points[rows // 2, 3] *= 1 - dent
    faces = []
    for i in range(rows - 1):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            faces += [(a, a + columns, b + columns)] * (i < rows - 2) + [(a, b + columns, b)] * (i > 0)
    return points.reshape(-1, 3), np.array(faces)


@pytest.mark.parametrize("name", ["cube", "sphere", "cylinder"])
def test_primitives_of_clevr_are_convex(name: str) -> None:
    assert is_convex(primitive(name))


def test_a_dent_is_found() -> None:
    assert is_convex(mesh(*ball()))
    assert not is_convex(mesh(*ball(dent=0.1)))


def test_an_open_surface_and_one_of_two_parts_are_not() -> None:
    vertices, faces = ball()
    assert not is_convex(mesh(vertices, faces[:-1]))
    whole = mesh(vertices, faces)
    assert not is_convex(Mesh((*whole.parts, *whole.parts), "", None))


def test_a_surface_turned_inside_out_is_not() -> None:
    vertices, faces = ball()
    assert not is_convex(mesh(vertices, faces[:, ::-1]))
