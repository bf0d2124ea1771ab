"""A mesh far from the origin, as geographical coordinates put it, is that at the origin, or a note says what is lost.

The reference is the same mesh without the offset. Every coordinate and the offset are multiples of 2⁻¹³ below 2²²: the
sum is exact in 64 bits, and its decimal text is, too. In 32 bits the far mesh is on a grid of an eighth.
"""

import numpy as np
import pytest
import trimesh

from scene_attack.rendering.factory import build
from scene_attack.scenes.bundle import Bundle
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.reading.isolated import reader
from scene_attack.scenes.reading.process import exported
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import Settings

OFFSET = np.array([2.0**20, 2.0**21, -3.0 * 2**18])
"""About 2,400 km, in metres."""
ROUNDING = 4 * 2.0**-24
"""Of a position relative to the mesh's size, from its last conversion to 32 bits; the sums before are of 64 bits."""


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    """A ball of 5,120 triangles and radius 1, whose vertices are multiples of 2⁻¹³."""
    made = trimesh.creation.icosphere(subdivisions=4)
    return trimesh.Trimesh(np.round(made.vertices * 2**13) / 2**13, made.faces, process=False)


def rows(values: np.ndarray, before: str = "", after: str = "") -> str:
    return "".join(f"{before}{' '.join(map(repr, row))}{after}\n" for row in values.tolist())


def obj(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    return (rows(vertices, "v ") + rows(faces + 1, "f ")).encode()


def ply(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """In text, whose coordinates are declared as `float`, as most programs do."""
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\n"
    head += "property float x\nproperty float y\nproperty float32 z\n"
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    return (head + rows(vertices) + rows(faces, "3 ")).encode()


def stl(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    facets = [f"facet normal 0 0 0\nouter loop\n{rows(t, 'vertex ')}endloop\nendfacet\n" for t in vertices[faces]]
    return f"solid\n{''.join(facets)}endsolid\n".encode()


def off(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    return f"OFF\n{len(vertices)} {len(faces)} 0\n{rows(vertices)}{rows(faces, '3 ')}".encode()


TEXTS = {"obj": obj, "ply": ply, "stl": stl, "off": off}


@pytest.mark.parametrize("kind", TEXTS)
def test_a_far_mesh_in_text_is_the_mesh_at_the_origin(kind: str, ball: trimesh.Trimesh) -> None:
    write = TEXTS[kind]
    (near,), _ = reader().read_mesh(write(ball.vertices, ball.faces), kind, 10_000)
    (far,), said = reader().read_mesh(write(ball.vertices + OFFSET, ball.faces), kind, 10_000)
    assert np.array_equal(far.faces, near.faces)
    assert np.allclose(far.vertices, near.vertices, rtol=0, atol=ROUNDING)
    assert said.dropped == ()


@pytest.mark.parametrize("kind", ["stl", "glb", "gltf", "dae"])
def test_a_note_says_what_32_bits_have_lost_of_a_far_mesh(kind: str, ball: trimesh.Trimesh) -> None:
    parts, said = reader().read_mesh(
        exported(trimesh.Trimesh(ball.vertices + OFFSET, ball.faces, process=False), kind), kind, 10_000
    )
    lost = 5_120 - sum(len(part.faces) for part in parts)
    assert lost > 500
    assert [note for note in said.dropped if f"{lost:,} of 5,120 triangles have collapsed" in note] != []
    near, about = reader().read_mesh(exported(ball, kind), kind, 10_000)
    assert sum(len(part.faces) for part in near) == 5_120
    assert not any("collapsed" in note for note in about.dropped)


def test_the_image_of_a_far_mesh_is_that_of_the_mesh_at_the_origin(tmp_path, ball: trimesh.Trimesh) -> None:
    library = Library(Settings().cache_dir, tmp_path)
    images = []
    for offset in (0.0 * OFFSET, OFFSET):
        name = library.add(Bundle("ply", ply(ball.vertices + offset, ball.faces), {})).name
        scene = Scene.model_validate({"objects": [{"mesh": name}], "camera": {"size": (48, 48)}})
        images.append(build(resolve(scene, library), "pyrender").exact().render({})[0])
    # At a silhouette a sample of a pixel may fall on either side of a position that differs in its last bit.
    assert float((images[1] - images[0]).abs().mean()) < 1e-4
