"""Furniture: orientation, proportions, materials, and a sample of the real libraries."""

import zipfile
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scene_attack.errors import JobFailure
from scene_attack.scenes.furniture import IDENTITY, Model, load_model
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.reading.surfaces import read_opacity
from tests.unit.scenes.mesh_files import extent

pytestmark = pytest.mark.slow

BOX = """
mtllib box.mtl
v -1 0 -3
v 1 0 -3
v 1 4 -3
v -1 4 -3
v -1 0 3
v 1 0 3
v 1 4 3
v -1 4 3
usemtl side
f 1 4 3 2
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
usemtl front
f 5 6 7 8
"""


def model(**changes):
    values = {
        "slug": "box",
        "key": "box",
        "title": "Box",
        "category": "c",
        "creator": "Ann",
        "licence": "CC0 1.0",
        "library": "T",
        "archive": Path("t.sh3f"),
        "path": "m/box/box.obj",
        "size": (2.0, 6.0, 4.0),
        "rotation": IDENTITY,
    }
    return Model(**values | changes)


def make(tmp_path, mtl="newmtl side\nKd 1 0 0\nnewmtl front\nKd 0 1 0\n", obj=BOX, **files):
    with zipfile.ZipFile(tmp_path / "t.sh3f", "w") as out:
        out.writestr("m/box/box.obj", obj)
        out.writestr("m/box/box.mtl", mtl)
        for name, data in files.items():
            out.writestr(f"m/box/{name.replace('_', '.')}", data)
    return tmp_path


def load(tmp_path, **changes):
    return load_model(model(archive=tmp_path / "t.sh3f", **changes), tmp_path / "cache")


def front(mesh):
    """The green part: in the file it faces +z."""
    (part,) = [part for part in mesh.parts if part.color[1] > 0.5]
    return part


def png(pixels):
    out = BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(out, "PNG")
    return out.getvalue()


def test_keeps_proportions_and_fits(tmp_path):
    mesh = load(make(tmp_path))
    assert np.allclose(extent(mesh.parts) / extent(mesh.parts)[0], [1, 2, 3], atol=1e-6)
    assert np.linalg.norm(extent(mesh.parts)) / 2 == pytest.approx(FIT_RADIUS)
    assert np.allclose(front(mesh).normals, [0, 0, 1])
    assert mesh.triangles == 12
    assert mesh.credit is not None
    assert "Ann" in mesh.credit


def test_is_stretched_to_the_catalogue_size_after_turning(tmp_path):
    # Row by row, the matrix takes +z (the front in the file) to +x.
    mesh = load(make(tmp_path), rotation=(0, 0, 1, 0, 1, 0, -1, 0, 0), size=(10.0, 20.0, 40.0))
    assert np.allclose(front(mesh).normals, [1, 0, 0], atol=1e-6)
    assert np.allclose(extent(mesh.parts) / extent(mesh.parts)[0], [1, 4, 2], atol=1e-6)


def test_a_model_that_lies_on_its_back_is_raised(tmp_path):
    # The matrix found most often in the catalogues: +z becomes +y.
    mesh = load(make(tmp_path), rotation=(1, 0, 0, 0, 0, 1, 0, -1, 0))
    assert np.allclose(front(mesh).normals, [0, 1, 0], atol=1e-6)


def test_a_flat_model_stays_flat(tmp_path):
    flat = "mtllib box.mtl\nv 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nusemtl front\nf 1 2 3 4\n"
    mesh = load(make(tmp_path, obj=flat), size=(60.0, 2.0, 30.0))
    assert np.allclose(extent(mesh.parts) / extent(mesh.parts)[0], [1, 0.5, 0], atol=1e-6)


def test_colours_are_made_linear_and_opacity_is_read(tmp_path):
    mesh = load(make(tmp_path, "newmtl side\nKd 0.5 0 0\nd 0.25\nnewmtl front\nKd 0 1 0\nTr 0.75\n"))
    side = next(part for part in mesh.parts if part is not front(mesh))
    # 128/255, as 8 bits hold 0.5, through the sRGB curve: ((0.50196 + 0.055) / 1.055)^2.4.
    assert np.allclose(side.color, [0.21586, 0, 0, 0.25], atol=1e-5)
    assert front(mesh).color[3] == pytest.approx(0.25)


@pytest.mark.parametrize("glass", ["side", "front"])
def test_opaque_parts_come_first(tmp_path, glass):
    mtl = "".join(f"newmtl {name}\nKd 0 1 0\nd {0.5 if name == glass else 1}\n" for name in ("side", "front"))
    mesh = load(make(tmp_path, mtl))
    assert [part.color[3] for part in mesh.parts] == [1.0, 0.5]


@pytest.mark.parametrize(
    ("mtl", "expected"),
    [
        ("newmtl a b\nd 0.5", {"a b": 0.5}),
        ("newmtl a\nTr 0.25\nnewmtl b\nKd 1 1 1", {"a": 0.75}),
        ("newmtl a\nd 0.5\nTr 0.25", {"a": 0.5}),
        ("newmtl a\nTr 0.25\nd 0.5", {"a": 0.5}),
        ("newmtl a\nd -halo 0.5", {"a": 0.5}),
        ("newmtl a\nd 7\nnewmtl b\nd x\nd", {"a": 1.0}),
    ],
)
def test_opacity(mtl, expected):
    assert read_opacity(mtl) == expected


TEXTURED = """
mtllib box.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl skin
f 1/1 2/2 3/3 4/4
"""
PIXELS = [[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [9, 9, 9]]]


@pytest.mark.parametrize("written", ["skin.png", "SKIN.PNG", ".\\skin.png", "C:/Users/bob/skin.png", "./skin.png"])
def test_textures_are_found_however_they_are_written(tmp_path, written):
    mesh = load(make(tmp_path, f"newmtl skin\nKd 1 1 1\nmap_Kd {written}\n", TEXTURED, skin_png=png(PIXELS)))
    (part,) = mesh.parts
    assert part.texture is not None
    assert part.texture[..., :3].tolist() == PIXELS
    assert (part.texture[..., 3] == 255).all()
    # Row 0 is the top and v goes up: the corner at the top left has uv (0, 1).
    top_left = np.argmin(part.vertices[:, 0] - part.vertices[:, 1])
    assert part.uv[top_left].tolist() == [0, 1]


def test_a_texture_under_black_is_shown(tmp_path):
    mesh = load(make(tmp_path, "newmtl skin\nKd 0 0 0\nmap_Kd skin.png\n", TEXTURED, skin_png=png(PIXELS)))
    assert mesh.parts[0].color.tolist() == [1, 1, 1, 1]


def test_a_missing_texture_leaves_the_colour(tmp_path):
    mesh = load(make(tmp_path, "newmtl skin\nKd 0 1 0\nmap_Kd none.png\n", TEXTURED))
    assert mesh.parts[0].texture is None
    assert mesh.parts[0].color.tolist() == [0, 1, 0, 1]


def test_nothing_outside_the_archive_is_read(tmp_path):
    secret = tmp_path / "secret.png"
    secret.write_bytes(png(PIXELS))
    for name in (str(secret), "../../secret.png", "../../../secret.png"):
        mesh = load(make(tmp_path, f"newmtl skin\nKd 0 1 0\nmap_Kd {name}\n", TEXTURED))
        assert mesh.parts[0].texture is None


def test_large_textures_are_reduced(tmp_path):
    pixels = np.zeros((1500, 3000, 3), np.uint8)
    pixels[:, 1500:] = 200
    mesh = load(make(tmp_path, "newmtl skin\nmap_Kd skin.png\n", TEXTURED, skin_png=png(pixels)))
    assert mesh.parts[0].texture.shape == (512, 1024, 4)
    assert (mesh.parts[0].texture[:, 512:, :3] == 200).all()


def test_the_second_time_comes_from_the_cache_and_is_the_same(tmp_path):
    make(tmp_path, "newmtl skin\nKd 1 1 1\nmap_Kd skin.png\n", TEXTURED, skin_png=png(PIXELS))
    first, second = load(tmp_path), load(tmp_path)
    (kept,) = (tmp_path / "cache").glob("*.npz")
    for a, b in zip(first.parts, second.parts, strict=True):
        for name, value in vars(a).items():
            assert np.array_equal(value, getattr(b, name))
            assert value is None or value.dtype == getattr(b, name).dtype
    kept.write_bytes(kept.read_bytes()[:100])
    assert np.array_equal(load(tmp_path).parts[0].vertices, first.parts[0].vertices), "a damaged file is made again"


def test_the_digest_covers_all_that_decides_the_mesh(tmp_path):
    def digest(mtl="newmtl skin\nmap_Kd skin.png\n", pixels=PIXELS, **changes):
        return load(make(tmp_path, mtl, TEXTURED, skin_png=png(pixels)), **changes).sha256

    digests = [
        digest(),
        digest(mtl="newmtl skin\nKd 1 1 0\n"),
        digest(pixels=PIXELS[::-1]),
        digest(size=(1.0, 1.0, 1.0)),
        digest(rotation=(0, 0, 1, 0, 1, 0, -1, 0, 0)),
    ]
    assert len(set(digests)) == len(digests)
    assert digest() == digests[0]
    assert digest(title="Another name") == digests[0]


@pytest.mark.parametrize("damage", ["gone", "no model", "no zip"])
def test_a_damaged_archive_is_a_missing_asset(tmp_path, damage):
    make(tmp_path)
    if damage == "gone":
        (tmp_path / "t.sh3f").unlink()
    if damage == "no zip":
        (tmp_path / "t.sh3f").write_bytes(b"PK nothing")
    with pytest.raises(JobFailure, match=r"asset-missing.*assets fetch"):
        load(tmp_path, **({"path": "m/box/other.obj"} if damage == "no model" else {}))


LIBRARIES = {"Blend Swap CC-0": 175, "Blend Swap CC-BY": 135, "Kator Legaz": 90, "Reallusion": 25, "Scopia": 395}


def test_the_catalogue_is_complete(library):
    entries = [entry for entry in library.entries() if entry.kind == "furniture"]
    assert len(entries) == sum(LIBRARIES.values()) == 820
    for name, count in LIBRARIES.items():
        assert sum((entry.credit or "").endswith(f"library {name}") for entry in entries) == count
    assert {entry.licence for entry in entries} == {"CC0 1.0", "CC BY 3.0", "CC BY 3.0 US"}
    assert all(entry.creator and entry.category and entry.size for entry in entries)


@pytest.mark.parametrize("part", range(5))
def test_a_sample_of_every_library_loads(library, part):
    name = list(LIBRARIES)[part]
    entries = [entry for entry in library.entries() if (entry.credit or "").endswith(f"library {name}")]
    for entry in entries[:: max(len(entries) // 5, 1)][:5]:
        mesh = library.mesh(entry.name)
        points = np.concatenate([p.vertices for p in mesh.parts])
        assert np.linalg.norm(points, axis=1).max() == pytest.approx(FIT_RADIUS, rel=1e-4), entry.name
        assert np.allclose(points.min(axis=0), -points.max(axis=0), atol=1e-4), entry.name
        width, depth, height = entry.size
        size = extent(mesh.parts)
        # A model that is flat in the file stays flat; else it has the catalogue's size.
        solid = size > 1e-6
        assert np.allclose(size[solid] * mesh.centimetres, np.array([width, height, depth])[solid], rtol=1e-3), (
            entry.name
        )
        for p in mesh.parts:
            assert np.allclose(np.linalg.norm(p.normals, axis=1), 1, atol=1e-4), entry.name
            assert p.texture is None or p.uv is not None


def test_the_basketball_is_round_and_its_normals_point_away_from_its_middle(library):
    (part,) = library.mesh("furniture/basketball").parts
    away = part.vertices / np.linalg.norm(part.vertices, axis=1, keepdims=True)
    # Its grooves turn away from that, but not many of its vertices are in one.
    assert np.median(np.abs((away * part.normals).sum(axis=1))) > 0.98


def test_the_real_materials_are_honoured(library):
    parts = library.mesh("furniture/aquarium").parts
    assert any(part.color[3] < 1 for part in parts), "its glass is transparent"
    assert any(part.texture is not None for part in library.mesh("furniture/camera").parts)
