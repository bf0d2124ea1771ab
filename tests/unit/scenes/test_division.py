"""Divided meshes: the same surface, short edges, no gap."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from scene_attack.process import options
from scene_attack.scenes.division import divided, pieces
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS, Mesh
from scene_attack.scenes.resolve import with_surface_of_part
from scene_attack.scenes.solids import outsides
from tests.unit.rendering import shapes

LONGEST = 0.025 * FIT_RADIUS


def corners(mesh: Mesh) -> np.ndarray:
    """Corners of all triangles [F, 3, 3]."""
    return np.concatenate([part.vertices.astype(np.float64)[part.faces] for part in mesh.parts])


def areas(mesh: Mesh) -> np.ndarray:
    """Vectors [F, 3] along the triangles' normals, as long as their areas."""
    a, b, c = np.moveaxis(corners(mesh), 1, 0)
    return np.cross(b - a, c - a) / 2


def named(name: str) -> Mesh:
    used = options()
    return Library(used.cache_dir, used.data_dir).mesh(name)


@pytest.mark.parametrize("name", ["primitive/cube", "primitive/cylinder", "furniture/desk-lamp", "furniture/chair"])
def test_no_edge_is_long_and_the_surface_is_the_same(name: str) -> None:
    mesh = named(name)
    short = divided(mesh, LONGEST)
    at = corners(short)
    assert np.linalg.norm(np.roll(at, -1, axis=1) - at, axis=-1).max() <= LONGEST * (1 + 1e-6)
    assert short.triangles > mesh.triangles
    for own, part in zip(mesh.parts, short.parts, strict=True):
        before, after = areas(Mesh((own,), "", None)), areas(Mesh((part,), "", None))
        # float32 places are off by 1e-7 of the size, on triangles of a hundredth
        assert np.linalg.norm(after, axis=1).sum() == pytest.approx(np.linalg.norm(before, axis=1).sum(), rel=1e-4)
        np.testing.assert_allclose(after.sum(axis=0), before.sum(axis=0), atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(part.normals, axis=1), 1, atol=1e-6)
        np.testing.assert_array_equal(part.vertices[: len(own.vertices)], own.vertices)


def watertight(mesh: Mesh) -> float:
    """Share of the triangles that are of watertight surfaces."""
    return sum(closed for _, closed in outsides(mesh)) / mesh.triangles


@pytest.mark.parametrize("name", ["primitive/cube", "primitive/torus", "furniture/desk-lamp"])
def test_neighbours_stay_neighbours(name: str) -> None:
    """Also where they share no vertices but have them at one place: each side of a cube has its own."""
    mesh = named(name)
    short = divided(mesh, LONGEST)
    before, after = watertight(mesh), watertight(short)
    assert (after > 0) == (before > 0)
    if before == 1:
        assert after == 1


def test_what_varies_over_a_triangle_varies_as_before() -> None:
    """Attributes that are linear in the place are so at every vertex, those of a glTF material too."""
    quad: Any = shapes.quad(0.5, uv=[[0, 0], [1, 0], [1, 1], [0, 1]])
    gltf = with_surface_of_part(quad, 0.0, 0.5)
    assert gltf.metallic_roughness is not None
    colors = np.concatenate([quad.vertices + 0.5, np.ones((4, 1), np.float32)], axis=1)
    varied = replace(gltf, metallic_roughness=replace(gltf.metallic_roughness, vertex_colors=colors))
    [part] = divided(Mesh((varied,), "", None), 0.03).parts
    assert part.uv is not None
    assert part.metallic_roughness is not None
    np.testing.assert_allclose(part.uv, part.vertices[:, :2] + 0.5, atol=1e-6)
    np.testing.assert_allclose(part.metallic_roughness.vertex_colors[:, :3], part.vertices + 0.5, atol=1e-6)
    assert part.metallic_roughness.second_uv.shape == (len(part.vertices), 2)


def test_short_edges_stay_as_they_are() -> None:
    mesh = Mesh((shapes.sphere(0.5, rings=96),), "", None)
    [part] = divided(mesh, 0.1).parts
    np.testing.assert_array_equal(part.faces, mesh.parts[0].faces)
    np.testing.assert_array_equal(part.vertices, mesh.parts[0].vertices)


@pytest.mark.parametrize("name", ["primitive/cube", "primitive/cylinder", "furniture/desk-lamp", "furniture/chair"])
def test_their_number_is_known_beforehand(name: str) -> None:
    """Slivers, of which only two edges are long, among them: a cylinder has 512, which become 600 each."""
    mesh = named(name)
    assert 0.9 < pieces(mesh, LONGEST) / divided(mesh, LONGEST).triangles < 2
