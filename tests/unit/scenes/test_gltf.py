"""What is read of a glTF file: geometry, transforms, attributes, materials; and what is refused, by its place."""

import json
import struct
from collections.abc import Callable
from io import BytesIO
from math import cos, pi, sin
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks.gltf_models import MODELS, checks, sphere
from scene_attack.errors import InvalidRequest
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS, MetallicRoughness, Part
from scene_attack.scenes.reading.formats import read_mesh
from scene_attack.scenes.reading.normals import derive_tangents
from scene_attack_accuracy.stability.gltf_file import Writer
from tests.unit.scenes.mesh_files import same

MANY = 300_000
TRIANGLE: dict[str, Any] = {"POSITION": np.eye(3), "indices": np.arange(3)}


def read(writer: Writer) -> tuple[Part, ...]:
    return read_mesh(writer.glb(), "glb", MANY)


def material(part: Part) -> MetallicRoughness:
    assert part.metallic_roughness is not None
    return part.metallic_roughness


def one(entry: dict[str, Any] | None = None, edit: Callable[[Writer], None] | None = None, **arrays: Any) -> Writer:
    writer = Writer()
    attributes = TRIANGLE | {name: np.array(values) for name, values in arrays.items()}
    writer.root(mesh=writer.mesh(writer.primitive(attributes, entry)))
    if edit:
        edit(writer)
    return writer


def turned(axis: int, angle: float) -> np.ndarray:
    matrix = np.eye(4)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix[i, i] = matrix[j, j] = cos(angle)
    matrix[i, j], matrix[j, i] = -sin(angle), sin(angle)
    return matrix


def test_nodes_put_meshes_where_the_product_of_their_matrices_does() -> None:
    parts = read_mesh(MODELS["nested transforms"](), "glb", MANY)
    root = turned(1, pi / 6)
    middle = root @ (np.diag([0.8, 0.6, 1.0, 1.0]) + np.outer(np.array([1.2, 0, 0, 0]), [0, 0, 0, 1]))
    leaf = middle @ turned(2, pi / 4) @ np.diag([1, 2, 1, 1])
    mirror = root @ (np.diag([-1.0, 1, 1, 1]) + np.outer([-1.1, 0.2, 0, 0], [0, 0, 0, 1]))
    ball = sphere(0.5)
    points = np.append(ball["POSITION"], np.ones((len(ball["POSITION"]), 1)), axis=1)
    placed = [(points @ matrix.T)[:, :3] for matrix in (root, leaf, mirror)]
    every = np.concatenate(placed)
    centre = (every.max(axis=0) + every.min(axis=0)) / 2
    scale = FIT_RADIUS / np.linalg.norm(every - centre, axis=1).max()
    assert len(parts) == 3
    for part, expected in zip(parts, placed, strict=True):
        reference = (expected - centre) * scale
        nearest = [np.abs(reference - vertex).max(axis=1).min() for vertex in part.vertices[::97]]
        assert max(nearest) < 1e-5
        corners = part.vertices[part.faces].astype(float)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        middle_of = (part.vertices.max(axis=0) + part.vertices.min(axis=0)) / 2
        outward = np.einsum("fi,fi->f", across, corners.mean(axis=1) - middle_of)
        assert (outward > 0).all(), "mirrored or not, the winding is seen from outside"
        normals = part.normals[part.faces].mean(axis=1)
        assert (np.einsum("fi,fi->f", normals, across) > 0).all()
    stretched = parts[1]
    # The normals of an ellipsoid x = A s are along the inverse transpose of A applied to s.
    linear = leaf[:3, :3]
    source = np.linalg.solve(linear, (stretched.vertices / scale + centre - leaf[:3, 3]).T).T
    expected_normals = source @ np.linalg.inv(linear)
    expected_normals /= np.linalg.norm(expected_normals, axis=1, keepdims=True)
    assert np.abs(stretched.normals - expected_normals).max() < 1e-4


def test_materials_and_their_factors_are_kept() -> None:
    above, below = read_mesh(MODELS["two materials"](), "glb", MANY)
    assert (material(above).metallic, material(above).roughness) == (1.0, 0.6)
    assert (material(below).metallic, material(below).roughness) == (0.0, 0.4)
    assert above.color.tolist() == pytest.approx([0.7, 0.7, 0.75, 1.0])
    assert not material(above).double_sided
    assert material(above).alpha_mode == "OPAQUE"


def test_what_is_left_out_has_the_defaults_of_gltf() -> None:
    (part,) = read(one())
    found = material(part)
    assert (found.metallic, found.roughness, found.emissive) == (1.0, 1.0, (0.0, 0.0, 0.0))
    assert (found.alpha_mode, found.alpha_cutoff, found.double_sided) == ("OPAQUE", 0.5, False)
    assert part.color.tolist() == [1, 1, 1, 1]
    assert (found.vertex_colors == 1).all()
    assert not part.textured


def test_without_normals_faces_are_flat() -> None:
    cube_corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    (part,) = read(one(POSITION=cube_corner, indices=[0, 2, 1, 0, 1, 3]))
    assert len(part.vertices) == 6
    assert part.normals[part.faces].tolist() == [[[0, 0, -1]] * 3, [[0, -1, 0]] * 3]


def test_both_sets_of_texture_coordinates_run_upwards() -> None:
    def texture(writer: Writer) -> None:
        writer.tree["meshes"][0]["primitives"][0]["material"] = writer.add(
            "materials", {"emissiveTexture": writer.texture(checks((0, 0, 0), (9, 9, 9)), texCoord=1)}
        )

    uv = [[0, 0], [1, 0], [0.5, 0.25]]
    (part,) = read(one(edit=texture, TEXCOORD_0=uv, TEXCOORD_1=np.array(uv) + 1, NORMAL=np.ones((3, 3))))
    assert part.uv is not None
    assert part.uv.tolist() == [[0, 1], [1, 1], [0.5, 0.75]]
    assert material(part).second_uv.tolist() == [[1, 0], [2, 0], [1.5, -0.25]]
    assert material(part).maps["emissive"].uv_set == 1


def transformed(**maps: dict[str, Any]) -> Callable[[Writer], None]:
    """A material with a texture for each name, which KHR_texture_transform moves."""

    def edit(writer: Writer) -> None:
        required("KHR_texture_transform")(writer)
        infos = {
            name: writer.texture(checks((0, 0, 0), (9, 9, 9))) | {"extensions": {"KHR_texture_transform": transform}}
            for name, transform in maps.items()
        }
        primitive(writer)["material"] = writer.add("materials", infos)

    return edit


CORNERS = np.array([[0, 0], [1, 0], [0.5, 0.25]])


def test_a_texture_is_scaled_then_turned_then_moved() -> None:
    """By a quarter turn u becomes -v, and v becomes u, with v downwards: what Blender writes for its own mapping."""
    moves = transformed(emissiveTexture={"offset": [0.25, 0.5], "rotation": np.pi / 2, "scale": [2, 3]})
    (part,) = read(one(edit=moves, TEXCOORD_0=CORNERS, NORMAL=np.ones((3, 3))))
    assert part.uv is not None
    u, v = 2 * CORNERS[:, 0], 3 * CORNERS[:, 1]
    assert part.uv == pytest.approx(np.stack([0.25 + v, 1 - (0.5 - u)], axis=1))
    assert material(part).maps["emissive"].uv_set == 0


def test_maps_may_have_two_places() -> None:
    """The transform names the set, and one map is where the other was without it."""
    moves = transformed(emissiveTexture={"scale": [2, 2], "texCoord": 1}, occlusionTexture={})
    (part,) = read(one(edit=moves, TEXCOORD_0=CORNERS, TEXCOORD_1=CORNERS + 1, NORMAL=np.ones((3, 3))))
    sets = (part.uv, material(part).second_uv)
    places = {"emissive": 2 * (CORNERS + 1), "occlusion": CORNERS}
    for name, texture in material(part).maps.items():
        assert sets[texture.uv_set] == pytest.approx(np.stack([places[name][:, 0], 1 - places[name][:, 1]], axis=1))


@pytest.mark.parametrize(("kind", "scale"), [(5121, 255), (5123, 65535)])
def test_colours_stored_as_integers_are_shares(kind: int, scale: int) -> None:
    def integers(writer: Writer) -> None:
        stored = np.array([[scale, 0, scale // 5, scale]] * 3, np.uint8 if kind == 5121 else np.uint16)
        view = writer.data(stored.tobytes())
        entry = {"bufferView": view, "componentType": kind, "normalized": True, "count": 3, "type": "VEC4"}
        writer.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = writer.add("accessors", entry)

    (part,) = read(one(edit=integers))
    assert material(part).vertex_colors[0].tolist() == pytest.approx([1, 0, 0.2, 1], abs=1e-6)


@pytest.mark.parametrize(("mode", "faces"), [(5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]])])
def test_strips_and_fans_are_triangles(mode: int, faces: list[list[int]]) -> None:
    corners = np.array(
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]] if mode == 6 else [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    )

    def as_mode(writer: Writer) -> None:
        writer.tree["meshes"][0]["primitives"][0]["mode"] = mode

    (part,) = read(one(edit=as_mode, POSITION=corners, NORMAL=[[0, 0, 1]] * 4, indices=[0, 1, 2, 3]))
    assert part.faces.tolist() == faces


def test_a_strided_buffer_is_read() -> None:
    def interleaved(writer: Writer) -> None:
        stored = np.hstack([np.eye(3), np.tile([0, 0, 1], (3, 1)), np.zeros((3, 1))]).astype(np.float32)
        view = writer.data(stored.tobytes())
        writer.tree["bufferViews"][view]["byteStride"] = 28
        shared = {"bufferView": view, "componentType": 5126, "count": 3, "type": "VEC3"}
        attributes = writer.tree["meshes"][0]["primitives"][0]["attributes"]
        attributes["POSITION"] = writer.add("accessors", shared)
        attributes["NORMAL"] = writer.add("accessors", shared | {"byteOffset": 12})

    (part,) = read(one(edit=interleaved))
    assert (part.normals == [0, 0, 1]).all()
    assert np.allclose(np.ptp(part.vertices, axis=0), np.ptp(part.vertices))


def test_a_processed_file_comes_back_from_disk(tmp_path: Any) -> None:
    for name, make in MODELS.items():
        entry = Library(tmp_path / name / "cache", tmp_path / name / "data").add_mesh(make(), "glb")
        kept = Library(tmp_path / name / "cache", tmp_path / name / "data").mesh(entry.name).parts
        fresh = read_mesh(make(), "glb", MANY)
        assert all(same(one_part, other) for one_part, other in zip(kept, fresh, strict=True))


def test_tangents_run_along_u_and_mirrored_texture_splits_vertices() -> None:
    ball = sphere()
    uv = ball["TEXCOORD_0"] * (1, -1)
    faces = ball["indices"].reshape(-1, 3)
    split = derive_tangents(ball["POSITION"], ball["NORMAL"], uv, faces)
    x, _, z = ball["NORMAL"][split.source].T
    away = np.hypot(x, z)
    along = np.stack([z, 0 * x, -x], axis=1) / np.maximum(away, 1e-9)[:, None]
    inner = away > 0.2
    # The mean over the faces of a 48-ring ball is off by up to half of one of its 3.75 degrees.
    assert np.abs(split.tangents[inner, :3] - along[inner]).max() < 0.04
    assert (split.tangents[:, 3] == 1).all()
    assert np.abs(np.linalg.norm(split.tangents[:, :3], axis=1) - 1).max() < 1e-9
    half = np.stack([np.abs(uv[:, 0] - 0.5), uv[:, 1]], axis=1)  # mirrored about u = 0.5
    split = derive_tangents(ball["POSITION"], ball["NORMAL"], half, faces)
    assert len(split.source) > len(ball["POSITION"])
    assert set(split.tangents[:, 3]) == {1.0, -1.0}
    sides = split.tangents[split.faces][..., 3]
    assert (sides == sides[:, :1]).all(), "no triangle has both"


def test_where_texture_coordinates_span_nothing_any_tangent_will_do() -> None:
    split = derive_tangents(np.eye(3), np.ones((3, 3)) / 3**0.5, np.zeros((3, 2)), np.array([[0, 1, 2]]))
    assert np.abs(np.linalg.norm(split.tangents[:, :3], axis=1) - 1).max() < 1e-9
    assert np.abs(split.tangents[:, :3].sum(axis=1)).max() < 1e-9


def texture_of(data: bytes) -> Callable[[Writer], None]:
    def edit(writer: Writer) -> None:
        image = writer.add("images", {"bufferView": writer.data(data), "mimeType": "image/png"})
        info = {"index": writer.add("textures", {"source": image})}
        writer.tree["meshes"][0]["primitives"][0]["material"] = writer.add("materials", {"emissiveTexture": info})

    return edit


def damaged_png() -> bytes:
    writer = Writer()
    writer.texture(checks((0, 0, 0), (9, 9, 9)))
    data = writer.glb()
    start = data.index(b"\x89PNG")
    return data[start : start + 60] + b"\0" * 60


def required(name: str) -> Callable[[Writer], None]:
    return lambda writer: writer.tree.update(extensionsUsed=[name], extensionsRequired=[name])


def primitive(writer: Writer) -> dict[str, Any]:
    first: dict[str, Any] = writer.tree["meshes"][0]["primitives"][0]
    return first


FIRST = "meshes[0].primitives[0]"
INNER = "materials[0].pbrMetallicRoughness"
BAD: dict[str, tuple[Writer, str]] = {
    "metallic beyond 1": (one({"pbrMetallicRoughness": {"metallicFactor": 1.5}}), f"{INNER}.metallicFactor is 1.5"),
    "roughness below 0": (one({"pbrMetallicRoughness": {"roughnessFactor": -0.1}}), f"{INNER}.roughnessFactor is -0.1"),
    "not a number": (one({"pbrMetallicRoughness": {"metallicFactor": float("nan")}}), f"{INNER}.metallicFactor is nan"),
    "infinite": (one({"emissiveFactor": [0, float("inf"), 0]}), "materials[0].emissiveFactor is inf"),
    "emission beyond 1": (one({"emissiveFactor": [0, 3, 0]}), "materials[0].emissiveFactor is 3"),
    "a word": (one({"alphaCutoff": "half"}), "materials[0].alphaCutoff is 'half'"),
    "three for four": (one({"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1]}}), "not a list of 4 numbers"),
    "three places of maps": (
        one(
            edit=transformed(emissiveTexture={}, occlusionTexture={"scale": [2, 2]}, normalTexture={"rotation": 1}),
            TEXCOORD_0=[[0, 0]] * 3,
        ),
        "materials[0] has maps at 3 different places",
    ),
    "a scale of a texture": (
        one(edit=transformed(emissiveTexture={"scale": [2]}), TEXCOORD_0=[[0, 0]] * 3),
        "materials[0].emissiveTexture.extensions.KHR_texture_transform.scale is not a list of 2 numbers",
    ),
    "alpha mode": (one({"alphaMode": "GLASS"}), "materials[0].alphaMode is 'GLASS'"),
    "double-sided": (one({"doubleSided": 1}), "materials[0].doubleSided is 1"),
    "no such material": (one(edit=lambda w: w.tree["meshes"][0]["primitives"][0].update(material=7)), "materials[7]"),
    "text as an image": (one(edit=texture_of(b"not an image"), TEXCOORD_0=[[0, 0]] * 3), "images[0] is not a readable"),
    "damaged image": (one(edit=texture_of(damaged_png()), TEXCOORD_0=[[0, 0]] * 3), "images[0] is not a readable"),
    "required extension": (one(edit=required("KHR_materials_unlit")), "KHR_materials_unlit"),
    "third set": (one({"emissiveTexture": {"index": 0, "texCoord": 2}}), "materials[0].emissiveTexture.texCoord is 2"),
    "no such texture": (one({"normalTexture": {"index": 4}}), "textures[4]"),
    "unequal attributes": (one(NORMAL=np.ones((2, 3))), "2 of NORMAL for 3 vertices"),
    "colours not finite": (one(COLOR_0=np.full((3, 3), np.nan)), "COLOR_0 has values that are not finite"),
    "texture coordinates far out": (one(TEXCOORD_0=np.full((3, 2), -3e38)), "TEXCOORD_0 has values beyond 1e+30"),
    "no such vertex": (one(indices=[0, 1, 9]), "names a vertex that is not there"),
    "sparse": (one(edit=lambda w: w.tree["accessors"][0].update(sparse={"count": 1})), "accessors[0] is sparse"),
    "quaternion": (one(edit=lambda w: w.tree["nodes"][0].update(rotation=[0, 0, 0, 0])), "nodes[0].rotation"),
    "scale": (one(edit=lambda w: w.tree["nodes"][0].update(scale=[1, float("nan"), 1])), "nodes[0].scale is nan"),
    "own ancestor": (one(edit=lambda w: w.tree["nodes"][0].update(children=[0])), "its nodes are not a tree"),
    "flat": (one(edit=lambda w: w.tree["nodes"][0].update(scale=[0, 0, 1])), "area"),
    "no positions": (
        one(edit=lambda w: primitive(w)["attributes"].pop("POSITION")),
        f"{FIRST} has no attributes.POSITION",
    ),
    "no attributes": (one(edit=lambda w: primitive(w).pop("attributes")), f"{FIRST} has no attributes.POSITION"),
    "no primitive": (one(edit=lambda w: w.tree["meshes"][0].update(primitives=[None])), f"{FIRST} is not an object"),
    "no list": (one(edit=lambda w: w.tree["meshes"][0].update(primitives={})), "meshes[0].primitives is not a list"),
    "mode": (one(edit=lambda w: primitive(w).update(mode="triangles")), f"{FIRST}.mode is 'triangles'"),
    "no count": (one(edit=lambda w: w.tree["accessors"][0].pop("count")), "accessors[0].count is None"),
    "a list as a type": (one(edit=lambda w: w.tree["accessors"][0].update(type=["VEC3"])), "accessors[0] has the type"),
    "a list as a component": (one(edit=lambda w: w.tree["accessors"][0].update(componentType=[5126])), "accessors[0]"),
    "numbers as indices": (one(edit=lambda w: primitive(w).update(indices=[0, 1, 2])), "accessors[[0, 1, 2]]"),
    "a list as a material": (one(edit=lambda w: primitive(w).update(material=[0])), "materials[[0]]"),
    "no mesh": (one(edit=lambda w: w.tree.update(meshes=[None])), "meshes[0] is not an object"),
    "no view": (one(edit=lambda w: w.tree.update(bufferViews=[None, None])), "bufferViews[0] is not an object"),
    "no children": (one(edit=lambda w: w.tree["nodes"][0].update(children=1)), "nodes[0].children is not a list"),
    "roots": (one(edit=lambda w: w.tree["scenes"][0].update(nodes=0)), "scenes[0].nodes is not a list"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_named(case: str) -> None:
    writer, words = BAD[case]
    with pytest.raises(InvalidRequest) as error:
        read(writer)
    assert error.value.field == "file"
    assert words in error.value.detail
    assert "Error" not in error.value.detail


def test_textures_want_their_coordinates() -> None:
    writer = one()
    writer.tree["materials"] = [{"emissiveTexture": writer.texture(checks((0, 0, 0), (9, 9, 9)))}]
    writer.tree["meshes"][0]["primitives"][0]["material"] = 0
    with pytest.raises(InvalidRequest, match="emissive texture wants TEXCOORD_0"):
        read(writer)


def test_quantized_positions_are_read() -> None:
    def integers(writer: Writer) -> None:
        required("KHR_mesh_quantization")(writer)
        stored = np.zeros((3, 4), np.int16)
        stored[:, :3] = np.eye(3) * 100
        view = writer.data(stored.tobytes())
        writer.tree["bufferViews"][view]["byteStride"] = 8
        entry = {"bufferView": view, "componentType": 5122, "count": 3, "type": "VEC3"}
        writer.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = writer.add("accessors", entry)

    (quantized,), (plain,) = read(one(edit=integers)), read(one())
    assert np.allclose(quantized.vertices, plain.vertices)


def test_a_glb_without_a_binary_chunk_is_refused() -> None:
    writer = one()
    writer.glb()  # says how long its buffer is
    text = json.dumps(writer.tree).encode()
    text += b" " * (-len(text) % 4)
    data = b"glTF" + struct.pack("<IIII", 2, 20 + len(text), len(text), 0x4E4F534A) + text
    with pytest.raises(InvalidRequest, match=r"beyond its buffer|more than the file holds"):
        read_mesh(data, "glb", MANY)


@pytest.mark.parametrize(("grey", "kind"), [(20_000, np.uint16), (78, np.uint8)])
def test_a_grey_texture_keeps_its_grey(grey: int, kind: type[np.generic]) -> None:
    """Pillow clips it to white: 20,000 of 65,535 is grey 78 of 255."""
    stored = BytesIO()
    Image.fromarray(np.full((4, 4), grey, kind)).save(stored, "PNG")
    writer = one({}, texture_of(stored.getvalue()), TEXCOORD_0=[[0, 0]] * 3)
    [part] = read(writer)
    assert part.metallic_roughness is not None
    [texture] = part.metallic_roughness.maps.values()
    assert (texture.texels == (78, 78, 78, 255)).all()
