"""Materials and textures beside a mesh: which are named, what is read of them, and what is said of them."""

import io

import numpy as np
import pytest
from PIL import Image

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.reading.companion_files import Named, collada_images, named_files, texture_name
from scene_attack.scenes.reading.isolated import reader
from tests.unit.scenes.mesh_files import ASCII_PLY, BOXES, MAX_FACES

OBJ = (
    b"mtllib my chair.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n"
    b"usemtl wood\nf 1/1 2/2 3/3\nusemtl glass\nf 1/1 2/2 4/3\nusemtl red\nf 1/1 3/2 4/3\n"
)
MTL = (
    b"newmtl wood\nKd 1 1 1\nmap_Kd -s 2 2 2 tex\\Wood.PNG\nmap_Bump bumps.png\n"
    b"newmtl glass\nKd 0 0 1\nd 0.25\nnewmtl red\nKd 1 0 0\nmap_Kd /home/me/capsule0.jpg\n"
)


def image(kind="PNG", color=(250, 0, 10)):
    buffer = io.BytesIO()
    Image.new("RGB", (2, 3), color).save(buffer, kind)
    return buffer.getvalue()


def read(files, data=OBJ, kind="obj"):
    return reader().read_mesh(data, kind, MAX_FACES, files)


def test_materials_and_textures_beside_an_obj_are_read_and_listed():
    parts, said = read({"My Chair.mtl": MTL, "tex/wood.png": image(), "bumps.png": image(), "other.png": image()})
    assert said.used == ("material library My Chair.mtl", "texture tex/wood.png")
    assert said.dropped == (
        "bump map bumps.png not used",
        "texture /home/me/capsule0.jpg missing",
        "options -s 2 2 2 of the texture tex\\Wood.PNG",
        "other.png not used: the mesh does not name it",
    )
    (wood,) = (part for part in parts if part.texture is not None)
    assert (wood.texture == (250, 0, 10, 255)).all()
    plain = {tuple(np.round(part.color, 3).tolist()) for part in parts if part.texture is None}
    assert plain == {(0.0, 0.0, 1.0, 0.25), (1.0, 0.0, 0.0, 1.0)}
    assert parts[-1].color[3] == 0.25, "what is seen through comes last"


def test_alone_it_is_read_without_and_says_what_is_missing():
    parts, said = read({})
    assert all(part.texture is None for part in parts)
    assert said.dropped == ("material library my chair.mtl missing",)


@pytest.mark.parametrize(("kind", "name"), [("BMP", "w.bmp"), ("GIF", "w.gif"), ("TGA", "w.tga"), ("JPEG", "w.jpg")])
def test_textures_of_other_formats_are_read(kind, name):
    files = {"my chair.mtl": f"newmtl wood\nmap_Kd {name}\n".encode(), name: image(kind)}
    parts, said = read(files)
    (textured,) = (part for part in parts if part.texture is not None)
    assert abs(textured.texture.astype(int) - (250, 0, 10, 255)).max() <= 3
    assert f"texture {name}" in said.used


@pytest.mark.parametrize("data", [b"hello", b"", b"%!PS-Adobe-3.0 EPSF-3.0\n", image()[:20], b"BM" + bytes(9)])
def test_a_texture_that_is_no_image_is_refused_by_its_name(data):
    with pytest.raises(InvalidRequest, match=r"file: the texture tex/w.png cannot be read: it is") as error:
        read({"my chair.mtl": b"newmtl wood\nmap_Kd tex/w.png\n", "tex/w.png": data})
    assert error.value.field == "file"


def test_a_texture_of_a_ply_is_read():
    """A square of two triangles with texture coordinates."""
    head = (
        "ply\nformat ascii 1.0\ncomment TextureFile w.png\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nproperty float s\nproperty float t\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"
    )
    (part,), said = read({"w.png": image()}, head.encode(), "ply")
    assert said.used == ("texture w.png",)
    assert (part.texture == (250, 0, 10, 255)).all()


def test_a_texture_without_coordinates_is_not_shown_and_says_so():
    data = ASCII_PLY.replace(b"element vertex", b"comment TextureFile w.png\nelement vertex", 1)
    _, said = read({"w.png": image()}, data, "ply")
    assert said.dropped == ("texture w.png not used: the mesh has no texture coordinates",)


def test_files_in_folders_are_found_by_path_and_else_by_a_name_that_is_the_only_one():
    files = {"my chair.mtl": b"newmtl wood\nmap_Kd a/w.png\n", "../a/w.png": image(), "../b/w.png": image()}
    assert "texture a/w.png missing" in read(files)[1].dropped
    del files["../b/w.png"]
    assert "texture ../a/w.png" in read(files)[1].used


def test_several_material_libraries_are_read_together():
    data = b"mtllib first.mtl\n" + OBJ.replace(b"mtllib my chair.mtl", b"mtllib second.mtl")
    parts, said = read({"first.mtl": b"newmtl red\nKd 1 0 0", "second.mtl": b"newmtl glass\nKd 0 1 0"}, data)
    assert said.used == ("material library first.mtl", "material library second.mtl")
    assert {(1, 0, 0, 1), (0, 1, 0, 1)} <= {tuple(part.color.tolist()) for part in parts}


def test_vertex_colours_of_an_obj_are_used_without_materials_and_dropped_beside_them():
    data = BOXES["obj"].replace(b"v -0.5", b"v -0.5", 1)
    data = b"v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\nf 1 2 3\n"
    (part,), said = read({}, data)
    assert said.used == ("vertex colours",)
    assert part.color.tolist() == [1, 0, 0, 1]
    _, said = read({"a.mtl": b"newmtl a\nKd 0 1 0\n"}, b"mtllib a.mtl\nusemtl a\n" + data)
    assert said.dropped == ("vertex colours",)


@pytest.mark.parametrize(
    ("text", "options", "name"),
    [
        ("wood.png", "", "wood.png"),
        (" my wood.png ", "", "my wood.png"),
        ("-s 1 2 3 -o 0.5 my wood.png", "-s 1 2 3 -o 0.5", "my wood.png"),
        ("-clamp on wood.png", "-clamp on", "wood.png"),
        ("-bm 0.2 -dirt.png", "-bm 0.2", "-dirt.png"),
        ("-s", "", "-s"),
    ],
)
def test_options_stand_before_the_name_of_a_texture(text, options, name):
    assert texture_name(text) == (options, name)


def test_names_are_found_once_and_in_their_order():
    assert [one.name for one in named_files(b"  mtllib a.mtl\r\nmtllib b c.mtl\nmtllib a.mtl\n", "obj")] == [
        "a.mtl",
        "b c.mtl",
    ]
    assert named_files(MTL, "mtl")[0] == ("tex\\Wood.PNG", "texture")
    assert named_files(b"mtllib x", "stl") == []


def test_a_material_that_cannot_be_seen_is_drawn_opaque_and_said():
    """Some programs write the opacity as `Tr`, which others read as its opposite."""
    parts, said = read({"my chair.mtl": b"newmtl wood\nTr 1.0\nnewmtl glass\nTr 0.75\nnewmtl red\nd 0\n"})
    assert sorted(part.color[3] for part in parts) == [0.25, 1, 1]
    assert said.dropped == ("opacity 0 of the material wood", "opacity 0 of the material red")


def test_names_are_printed_without_the_characters_that_steer_a_terminal():
    _, said = read({}, b"mtllib a\x1b[31m.mtl\n" + BOXES["obj"])
    assert said.dropped == ("material library a\ufffd[31m.mtl missing",)


def test_names_in_latin_1_are_found():
    mtl = "newmtl wood\nmap_Kd b\u00fcro.png\n".encode("latin-1")
    _, said = read({"my chair.mtl": mtl, "b\u00fcro.png": image()})
    assert "texture b\u00fcro.png" in said.used


IMAGES = """<library_images>
<image id="wood" name="w"><init_from> wood%20grain.png </init_from></image>
<image id="bumps"><init_from><ref>bumps &amp; dents.png</ref></init_from></image>
<image id="spare"><init_from>spare.png</init_from></image>
<image_source id="no"><init_from>no.png</init_from></image_source>
</library_images>"""
EFFECT = """<effect id="e"><profile_COMMON>
<newparam sid="surface"><surface type="2D"><init_from>wood</init_from></surface></newparam>
<newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>
<technique><phong><diffuse><texture texture="sampler" texcoord="UV"/></diffuse>
<bump bumptype="x"> <texture texture="bumps"/></bump></phong></technique></profile_COMMON></effect>"""


def test_images_are_named_by_what_they_are_to_an_effect() -> None:
    assert collada_images(f"<COLLADA>{IMAGES}{EFFECT}</COLLADA>".encode()) == [
        Named("wood%20grain.png", "texture"),
        Named("bumps & dents.png", "bump map"),
        Named("spare.png", "image"),
    ]


@pytest.mark.parametrize(
    "text",
    [
        '<image id="a">' * 200_000,
        "<effect " * 300_000,
        '<newparam sid="a">' * 100_000,
        "<effect>" + '<newparam sid="a">' * 100_000 + "</effect>",
        "<effect>" + "<diffuse " * 200_000 + "</effect>",
        '<image id="a"><init_from>' + " " * 2_000_000 + "</image>",
        "</image>" * 300_000,
    ],
    ids=["image", "effect", "newparam", "newparam of an effect", "slot", "blanks", "ends"],
)
def test_beginnings_without_an_end_are_read_at_once(text: str) -> None:
    """Looking for an end from each beginning took a minute and a half, and held up the uploads of everybody."""
    assert collada_images(text.encode()) == []
