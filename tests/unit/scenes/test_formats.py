"""What is kept of each format, as the table of docs/scene.md says it; and hostile files in XML and JSON."""

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.reading.isolated import reader
from tests.unit.scenes.format_files import BOUND, MODEL, TEXTURED, dae, gltf, obj, off, ply, three_mf, zipped
from tests.unit.scenes.mesh_files import MAX_FACES, extent

PAGE = Path(__file__).parents[3] / "docs" / "scene.md"
BASE = {"baseColorTexture": {"index": 0}}
MTL = "newmtl a\nKd 1 0 0\n{}\nnewmtl b\nKd 0 0 1\n"
BUMP = TEXTURED.replace("diffuse", "bump")
EMISSION = TEXTURED.replace("diffuse", "emission")
CASES = {
    ("vertex colours", "obj"): lambda: obj(colors=True),
    ("vertex colours", "ply"): lambda: ply(colors=True),
    ("vertex colours", "off"): lambda: off(colors=True),
    ("vertex colours", "gltf"): lambda: gltf(colors=True),
    ("vertex colours", "dae"): lambda: dae(colors=True, bound=False),
    ("vertex colours", "3mf"): lambda: three_mf('<m:colorgroup id="1"><m:color color="#FF0000"/></m:colorgroup>'),
    ("vertex colours beside a material", "obj"): lambda: obj(MTL, colors=True),
    ("vertex colours beside a material", "gltf"): lambda: gltf({"doubleSided": True}, colors=True),
    ("vertex colours beside a material", "dae"): lambda: dae(colors=True),
    ("texture and its coordinates", "obj"): lambda: obj(MTL.format("map_Kd w.png")),
    ("texture and its coordinates", "ply"): lambda: ply(texture=True),
    ("texture and its coordinates", "gltf"): lambda: gltf({"pbrMetallicRoughness": BASE}),
    ("texture and its coordinates", "dae"): lambda: dae(TEXTURED),
    ("texture and its coordinates", "3mf"): lambda: three_mf('<m:texture2d id="1" path="/3D/w.png"/>'),
    ("several materials", "obj"): lambda: obj(MTL),
    ("several materials", "gltf"): lambda: gltf({"emissiveFactor": [1, 0, 0]}),
    ("several materials", "dae"): dae,
    ("several materials", "3mf"): lambda: three_mf('<basematerials id="1"><base name="a"/></basematerials>'),
    ("metallic and roughness map", "obj"): lambda: obj(MTL.format("map_Pr w.png")),
    ("metallic and roughness map", "gltf"): lambda: gltf(
        {"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}}}
    ),
    ("normal or bump map", "obj"): lambda: obj(MTL.format("norm w.png")),
    ("normal or bump map", "gltf"): lambda: gltf({"normalTexture": {"index": 0}}),
    ("normal or bump map", "dae"): lambda: dae(f"{BUMP}<diffuse><color>1 0 0 1</color></diffuse>"),
    ("emission map", "obj"): lambda: obj(MTL.format("map_Ke w.png")),
    ("emission map", "gltf"): lambda: gltf({"emissiveTexture": {"index": 0}}),
    ("emission map", "dae"): lambda: dae(f"{EMISSION}<diffuse><color>1 0 0 1</color></diffuse>"),
    ("occlusion map", "gltf"): lambda: gltf({"occlusionTexture": {"index": 0}}),
}
WORDS = {
    "vertex colours": "vertex colours|colours",
    "vertex colours beside a material": "vertex colours",
    "texture and its coordinates": "textures?|base color map",
    "several materials": "materials",
    "metallic and roughness map": "metallic roughness map|roughness map",
    "normal or bump map": "normal map|bump map",
    "emission map": "emissive map|emission map",
    "occlusion map": "occlusion map",
}


def read(kind, files):
    data, others = files
    return reader().read_mesh(data, kind, MAX_FACES, others)


def table():
    """The table of the page: what is kept, by the row's name and the format."""
    rows = [
        [cell.strip() for cell in line.strip("|\n").split("|")]
        for line in PAGE.read_text("utf-8").splitlines()
        if line.startswith("|")
    ]
    formats = rows[0][1:]
    cells = ((row[0], kind, cell) for row in rows[2:] for kind, cell in zip(formats, row[1:], strict=True))
    return {(what, kind): cell for what, kind, cell in cells}


def test_the_table_has_every_case_and_no_other():
    assert {place for place, cell in table().items() if cell != "–"} == set(CASES)


@pytest.mark.parametrize(("what", "kind"), CASES)
def test_the_table_says_what_becomes_of_it(what, kind):
    parts, said = read(kind, CASES[what, kind]())
    words = re.compile(rf"^(?:{WORDS[what]})\b")
    dropped = any(words.match(one) for one in said.dropped)
    if what == "several materials" and not dropped:
        kept = len({part.color.tobytes() + repr(part.metallic_roughness and part.metallic_roughness.emissive).encode()
                    for part in parts}) == 2  # fmt: skip
    else:
        kept = any(words.match(one) for one in said.used)
        if kept and what == "vertex colours":
            colors = [part.color if part.metallic_roughness is None else part.metallic_roughness.vertex_colors[0]
                      for part in parts]  # fmt: skip
            assert all((color[:3] == (1, 0, 0)).all() for color in colors)
        if kept and what == "texture and its coordinates":
            assert any(part.textured for part in parts)
    assert kept != dropped, said
    assert ("kept" if kept else "dropped") == table()[what, kind]


def test_what_the_corners_of_a_triangle_lose_is_said():
    for kind, files in (("obj", obj(colors=True)), ("ply", ply(colors=True)), ("dae", dae(colors=True, bound=False))):
        _, said = read(kind, files)
        assert "blends of vertex colours: each triangle has the mean of its corners" in said.dropped
    for kind, files in (("gltf", gltf(colors=True)), ("ply", ply()), ("off", off(colors=True))):
        assert "blends" not in " ".join(read(kind, files)[1].dropped)


def test_opacity_of_colours_that_is_neither_nothing_nor_all_is_said_to_be_rounded():
    words = "partial opacity of colours: below a half is cut out, the rest is opaque"
    head, _, rows = ply(colors=True)[0].partition(b"end_header\n")
    head = head.replace(b"uchar blue\n", b"uchar blue\nproperty uchar alpha\n") + b"end_header\n"
    for opacities, said in (((0, 90, 255), True), ((255, 255, 255), False), ((0, 0, 0), False)):
        lines = rows.decode().splitlines()
        colored = [f"{line} {opacity}" for line, opacity in zip(lines[:3], opacities, strict=True)]
        # A second triangle of another colour: one colour alone is blended.
        more = ["0 0 1 0 255 0 255", "1 0 1 0 255 0 255", "0 1 1 0 255 0 255"]
        data = head.replace(b"vertex 3", b"vertex 6").replace(b"face 1", b"face 2")
        data += "\n".join([*colored, *more, "3 0 1 2", "3 3 4 5", ""]).encode()
        assert (words in read("ply", (data, {}))[1].dropped) == said


def test_texels_that_are_averaged_away_are_said():
    wide = io.BytesIO()
    Image.new("RGB", (1026, 4)).save(wide, "PNG")
    words = "detail of texture w.png: 1026×4 texels, of which at most 1024 a side are shown"
    data, others = obj(MTL.format("map_Kd w.png"))
    assert words in read("obj", (data, others | {"w.png": wide.getvalue()}))[1].dropped
    assert "detail" not in " ".join(read("obj", (data, others))[1].dropped)
    data, others = gltf({"pbrMetallicRoughness": BASE})
    tree, inside = json.loads(data), base64.b64encode(wide.getvalue()).decode()
    start, body = len(others["a.bin"]), others["a.bin"] + wide.getvalue()
    tree["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": len(wide.getvalue())})
    tree["buffers"][0]["byteLength"] = len(body)
    for image, name in (
        ({"bufferView": len(tree["bufferViews"]) - 1, "mimeType": "image/png"}, "images[0]"),
        ({"uri": f"data:image/png;base64,{inside}"}, "images[0]"),
        ({"uri": "w.png"}, "texture w.png"),
    ):
        sent = {"a.bin": body, "w.png": wide.getvalue()}
        _, said = read("gltf", (json.dumps(tree | {"images": [image]}).encode(), sent))
        assert words.replace("texture w.png", name) in said.dropped, image


def test_up_is_as_the_file_says():
    assert np.argmax(extent(read("3mf", three_mf())[0])) == 1, "what is 3 along z is 3 along y"
    lying, standing = (
        np.concatenate([part.vertices for part in read("dae", dae(up=up))[0]]) for up in ("Y_UP", "Z_UP")
    )
    turned = lying[:, [0, 2, 1]] * (1, 1, -1)
    assert np.allclose(turned[np.lexsort(turned.round(4).T)], standing[np.lexsort(standing.round(4).T)], atol=1e-5)
    assert not np.allclose(lying[np.lexsort(lying.round(4).T)], standing[np.lexsort(standing.round(4).T)], atol=1e-5)


def test_a_gltf_lacks_a_texture_that_was_not_sent_and_cannot_lack_its_buffer():
    data, files = gltf({"pbrMetallicRoughness": BASE})
    parts, said = read("gltf", (data, {"a.bin": files["a.bin"]}))
    assert said.dropped == ("texture tex%20ture/w.png missing",)
    assert not any(part.textured for part in parts)
    with pytest.raises(InvalidRequest, match=r"file: .*'a.bin', which was not sent"):
        read("gltf", (data, {}))
    with pytest.raises(InvalidRequest, match=r"tex%20ture/w.png\) is not a readable image"):
        read("gltf", (data, files | {"tex ture/w.png": b"text"}))


ENTITY = '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;">]>'
OUTSIDE = '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]>'


def with_doctype(text, doctype):
    head, mark, rest = text.partition("?>")
    return head + mark + doctype + rest


HOSTILE = {
    "entities in a dae": ("dae", lambda: with_doctype(dae()[0].decode(), ENTITY).encode(), "entities"),
    "a file's entity in a dae": ("dae", lambda: with_doctype(dae()[0].decode(), OUTSIDE).encode(), "entities"),
    "UTF-16 in a dae": ("dae", lambda: with_doctype(dae()[0].decode(), ENTITY).encode("utf-16"), "UTF-8"),
    "UTF-7 in a dae": ("dae", lambda: dae()[0].replace(b"utf-8", b"utf-7"), "'utf-7'"),
    "a billion triangles in a dae": ("dae", lambda: dae()[0].replace(b'count="1"', b'count="1000000000"'), "at most"),
    "deep XML in a dae": ("dae", lambda: b"<COLLADA>" + b"<a>" * 100_000, "not a readable dae"),
    "a zae": ("dae", lambda: zipped({"a.dae": dae()[0]}), "not a readable dae"),
    "entities in a 3mf": ("3mf", lambda: three_mf(model=with_doctype(MODEL, OUTSIDE))[0], "entities"),
    "a bomb as 3mf": ("3mf", lambda: zipped({"3D/3dmodel.model": bytes(2**22)}), "unpacks to"),
    "a 3mf with a path outside": ("3mf", lambda: zipped({"../3dmodel.model": b"<model/>"}), "points outside"),
    "a 3mf without a model": ("3mf", lambda: zipped({"a.txt": b""}), "no 3D model"),
    "glTF 1": ("gltf", lambda: b'{"asset": {"version": "1.0"}}', "glTF '1.0'"),
    "a file's address in a gltf": (
        "gltf",
        lambda: json.dumps(json.loads(gltf()[0]) | {"buffers": [{"uri": "/etc/passwd", "byteLength": 9}]}).encode(),
        "which was not sent",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_are_refused(case):
    kind, make, said = HOSTILE[case]
    with pytest.raises(InvalidRequest, match=said) as error:
        read(kind, (make(), {}))
    assert error.value.field == "file"


def test_the_files_of_the_table_are_what_they_are_meant_to_be():
    assert BOUND in dae()[0].decode()
