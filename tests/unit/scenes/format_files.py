"""Small mesh files of every format, each with one of the things that a format may hold."""

import io
import json
import zipfile

import numpy as np
from PIL import Image

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
UV = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
COLORS = np.array([[1, 0, 0], [1, 0, 0], [1, 0, 0]], np.float32)
Files = tuple[bytes, dict[str, bytes]]
"""A mesh file, and those beside it."""


def png(color=(250, 0, 10)) -> bytes:
    """An image of one colour."""
    buffer = io.BytesIO()
    Image.new("RGB", (2, 3), color).save(buffer, "PNG")
    return buffer.getvalue()


def zipped(files: dict[str, bytes]) -> bytes:
    """A zip file."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def obj(mtl="", colors=False) -> Files:
    """An obj; its second triangle has the material b."""
    red = " 1 0 0" if colors else ""
    lines = [f"v {x:g} {y:g} {z:g}{red}" for x, y, z in (*TRIANGLE, (0, 0, 1))] + [f"vt {u:g} {v:g}" for u, v in UV]
    head = ["mtllib a.mtl", "usemtl a"] if mtl else []
    lines += [*head, "f 1/1 2/2 3/3", *(["usemtl b"] if mtl else []), "f 1/1 4/3 2/2"]
    if not mtl:  # texture coordinates would hide the colours
        lines = [line.replace("/1", "").replace("/2", "").replace("/3", "") for line in lines if line[:2] != "vt"]
    return "\n".join(lines).encode(), {"a.mtl": mtl.encode(), "w.png": png()} if mtl else {}


def ply(colors=False, texture=False) -> Files:
    """A ply, in text."""
    head = ["ply", "format ascii 1.0", *(["comment TextureFile w.png"] if texture else []), "element vertex 3"]
    head += [f"property float {name}" for name in (*"xyz", *("st" if texture else ""))]
    head += [f"property uchar {name}" for name in ("red", "green", "blue") if colors]
    head += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    rows = []
    for place, uv in zip(TRIANGLE, UV, strict=True):
        rows.append(" ".join([f"{x:g}" for x in (*place, *(uv if texture else ()))] + ["255 0 0"] * colors))
    return "\n".join([*head, *rows, "3 0 1 2", ""]).encode(), {"w.png": png()} if texture else {}


def off(colors=False) -> Files:
    """An off."""
    rows = [" ".join(f"{x:g}" for x in place) + (" 255 0 0 255" if colors else "") for place in TRIANGLE]
    return "\n".join(["COFF" if colors else "OFF", "3 1 0", *rows, "3 0 1 2", ""]).encode(), {}


def gltf(material=None, colors=False) -> Files:
    """A gltf with its buffer and its image beside it; two primitives with the materials 0 and 1."""
    arrays = {"POSITION": TRIANGLE, "TEXCOORD_0": UV} | ({"COLOR_0": COLORS} if colors else {})
    body, views, accessors = b"", [], []
    for array in arrays.values():
        views.append({"buffer": 0, "byteOffset": len(body), "byteLength": array.nbytes})
        kind = f"VEC{array.shape[1]}"
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": 3, "type": kind})
        body += array.tobytes()
    attributes = {name: k for k, name in enumerate(arrays)}
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "material": k} for k in (0, 1)]}],
        "materials": [material or {}, {"doubleSided": True}],
        "textures": [{"source": 0}],
        "images": [{"uri": "tex%20ture/w.png"}],
        "buffers": [{"uri": "a.bin", "byteLength": len(body)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    return json.dumps(tree).encode(), {"a.bin": body, "tex ture/w.png": png()}


DAE = """<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>{up}</up_axis></asset>
<library_images><image id="im"><init_from>w.png</init_from></image></library_images>
<library_effects><effect id="e"><profile_COMMON>
<newparam sid="s"><surface type="2D"><init_from>im</init_from></surface></newparam>
<newparam sid="t"><sampler2D><source>s</source></sampler2D></newparam>
<technique sid="common"><lambert>{slots}</lambert></technique></profile_COMMON></effect>
<effect id="f"><profile_COMMON><technique sid="common"><lambert><diffuse><color>0 0 1 1</color></diffuse>
</lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="m"><instance_effect url="#e"/></material>
<material id="n"><instance_effect url="#f"/></material></library_materials>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<source id="u"><float_array id="ua" count="8">0 0 1 0 0 1 1 1</float_array><technique_common>
<accessor source="#ua" count="4" stride="2"><param name="S" type="float"/><param name="T" type="float"/></accessor>
</technique_common></source>
<source id="c"><float_array id="ca" count="12">1 0 0 1 0 0 1 0 0 1 0 0</float_array><technique_common>
<accessor source="#ca" count="4" stride="3"><param name="R" type="float"/><param name="G" type="float"/>
<param name="B" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1" material="M"><input semantic="VERTEX" source="#v" offset="0"/>{inputs}<p>0 1 2</p></triangles>
<triangles count="1" material="N"><input semantic="VERTEX" source="#v" offset="0"/>{inputs}<p>0 3 1</p></triangles>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="w"><node id="o"><instance_geometry url="#g">{bound}</instance_geometry>
</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene></COLLADA>"""
BOUND = (
    '<bind_material><technique_common><instance_material symbol="M" target="#m"/>'
    '<instance_material symbol="N" target="#n"/></technique_common></bind_material>'
)
RED = "<diffuse><color>1 0 0 1</color></diffuse>"
TEXTURED = '<diffuse><texture texture="t" texcoord="U"/></diffuse>'


def dae(slots=RED, colors=False, bound=True, up="Y_UP") -> Files:
    """A dae; its second triangle has the material n."""
    inputs = '<input semantic="TEXCOORD" source="#u" offset="0" set="0"/>'
    inputs += '<input semantic="COLOR" source="#c" offset="0"/>' if colors else ""
    text = DAE.format(up=up, slots=slots, inputs=inputs, bound=BOUND if bound else "")
    return text.encode(), {"w.png": png()}


MODEL = (
    '<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" '
    'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
    'xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02"><resources>{resources}'
    '<object id="9" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/>'
    '<vertex x="0" y="2" z="0"/><vertex x="0" y="0" z="3"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/>'
    '<triangle v1="0" v2="1" v3="3"/><triangle v1="0" v2="3" v3="2"/><triangle v1="1" v2="2" v3="3"/></triangles>'
    '</mesh></object></resources><build><item objectid="9"/></build></model>'
)


def three_mf(resources="", model=MODEL) -> Files:
    """A 3mf."""
    return zipped(
        {"[Content_Types].xml": b"<Types/>", "3D/3dmodel.model": model.format(resources=resources).encode()}
    ), {}
