"""Draws mesh files with pyrender as it is installed, for `benchmarks.own_meshes`, in a process of its own.

Reads requests as `benchmarks.stock_pyrender` does, each with three more fields: `matte`, whether the surface is made a
dielectric of roughness 1; `z_up`, whether the model is turned so that its +z is up; and `alike`. Writes uint8
[height, width, 4], the last 255 where there is a surface. With `mend`, what pyrender and the loader are known to leave
out or to read otherwise is put right before it draws:
- the names of textures have slashes instead of backslashes, for the loader finds no others;
- a mesh without colour is as light grey as ours, and a texture without material is not dimmed by a grey of the loader;
- colours of materials and vertices are displayed values, and normals are smoothed below 40° (not those of glTF files);
- textures repeat as the sampler of a glTF file says, for the loader drops it;
- alpha modes, backs and emission are those of glTF, see `benchmarks.stock_shader`; what blends is drawn last, for the
  renderer looks for an alpha below 1 among texels of 0 to 255.

With `alike`, it also draws as ours does what is not right or wrong but done otherwise:
- colours of texels are decoded before they are averaged, and of textures at most 1,024 texels a side are used;
- normals are means of the faces' by their angles, and one that bends beyond the horizon is put on it;
- a triangle has the mean of its corners' colours; with less than half the opacity it is cut out, else it is opaque.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyrender
import trimesh
from numpy.typing import NDArray

from benchmarks.stock_pyrender import _light
from benchmarks.stock_shader import MendedRenderer, decode
from services.scenes.normals import smooth_normals
from services.scenes.surfaces import MAX_TEXTURE

UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1.0]])
PLAIN = 204
"""Displayed grey, 0 to 255, of a mesh without colour in our images."""
CREASE = np.radians(40)


def main() -> None:
    """Draws the images that standard input asks for."""
    renderer = pyrender.OffscreenRenderer(1, 1)
    stock, mended = renderer._renderer, MendedRenderer()  # noqa: SLF001 - pyrender offers no other way
    for request in json.load(sys.stdin):
        renderer._renderer = mended if request["mend"] else stock  # noqa: SLF001
        mended.alike = request["alike"]
        renderer.viewport_height, renderer.viewport_width = request["size"]
        color, depth = renderer.render(_scene(request))
        np.save(request["out"], np.dstack([color[..., :3], np.where(depth > 0, 255, 0).astype(np.uint8)]))


def _scene(request: dict[str, Any]) -> pyrender.Scene:
    matte, mend = request["matte"], request["mend"]
    model = _with_slashes(Path(request["file"])) if mend else trimesh.load_scene(request["file"])
    if request["z_up"]:
        model.apply_transform(UPRIGHT)
    points = model.to_geometry().vertices
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    scale = request["radius"] / np.linalg.norm(points - middle, axis=1).max()
    placement = np.diag([scale, scale, scale, 1.0])
    placement[:3, 3] = -scale * middle
    model.apply_transform(placement)
    if not mend:
        drawn = pyrender.Scene.from_trimesh_scene(model)
    else:
        drawn = _mended(model, request["alike"]) if matte else _with_alpha(model)
    drawn.bg_color, drawn.ambient_light = np.zeros(4), np.zeros(3)
    for node in drawn.mesh_nodes if matte else ():
        for primitive in node.mesh.primitives:
            primitive.material.metallicFactor, primitive.material.roughnessFactor = 0.0, 1.0
            primitive.material.doubleSided = True
    if mend and not matte:
        _sample(drawn, Path(request["file"]))
    if request["alike"]:
        decode(drawn, MAX_TEXTURE)
    height, width = request["size"]
    camera = pyrender.PerspectiveCamera(yfov=request["field_of_view"], aspectRatio=width / height, znear=0.05, zfar=50)
    drawn.add(camera, pose=np.array(request["pose"]))
    light, pose = _light(request["light"])
    drawn.add(light, pose=pose)
    return drawn


def _mended(model: trimesh.Scene, alike: bool) -> pyrender.Scene:
    """The meshes of a model, with normals and colours as we read them from a file that is no glTF file."""
    drawn = pyrender.Scene()
    for mesh in model.dump():
        if isinstance(mesh, trimesh.Trimesh):
            smooth = trimesh.graph.smooth_shade(mesh, angle=CREASE)
            made = pyrender.Mesh.from_trimesh(smooth, smooth=smooth.visual.kind != "face")
            if alike:
                _as_ours(made.primitives[0], mesh)
            _displayed(made.primitives[0], smooth.visual)
            drawn.add(made)
    return drawn


def _as_ours(primitive: pyrender.Primitive, mesh: trimesh.Trimesh) -> None:
    """Gives a primitive the normals of ours, and each triangle one colour, which is opaque, or cuts it out."""
    found = smooth_normals(mesh.vertices, mesh.faces)
    corners = found.faces.ravel()
    primitive.positions, primitive.normals = mesh.vertices[found.source][corners], found.normals[corners]
    primitive.indices = None
    if primitive.texcoord_0 is not None:
        primitive.texcoord_0 = mesh.visual.uv[found.source][corners]
    if primitive.color_0 is not None:
        colors = np.repeat(mesh.visual.face_colors[found.kept], 3, axis=0)
        solid = colors[:, 3] > 127
        primitive.positions, primitive.normals = primitive.positions[solid], primitive.normals[solid]
        colors[:, 3] = 255
        primitive.color_0 = colors[solid]


def _with_alpha(model: trimesh.Scene) -> pyrender.Scene:
    """The meshes of a glTF file, each with the alpha mode of its material."""
    drawn = pyrender.Scene()
    for node in model.graph.nodes_geometry:
        pose, name = model.graph[node]
        made = pyrender.Mesh.from_trimesh(model.geometry[name])
        stated, material = model.geometry[name].visual.material, made.primitives[0].material
        material.alphaMode = stated.alphaMode or "OPAQUE"
        material.alphaCutoff = 0.5 if stated.alphaCutoff is None else stated.alphaCutoff
        if material.alphaMode == "BLEND" and material.baseColorTexture is not None:
            material.baseColorTexture._is_transparent = True  # noqa: SLF001 - or it is drawn with what is solid
        drawn.add(made, pose=pose)
    return drawn


def _with_slashes(path: Path) -> trimesh.Scene:
    """The model, whose material libraries name textures with slashes."""
    if path.suffix != ".obj":
        return trimesh.load_scene(path)
    with tempfile.TemporaryDirectory() as folder:
        for one in path.parent.iterdir():
            if one.is_file():
                data = one.read_bytes()
                (Path(folder) / one.name).write_bytes(data.replace(b".\\", b"") if one.suffix == ".mtl" else data)
        return trimesh.load_scene(Path(folder) / path.name)


def _displayed(primitive: pyrender.Primitive, visual: Any) -> None:
    """Colours of a primitive as displayed values; our grey where the file says nothing."""
    material = primitive.material
    factor = np.asarray(material.baseColorFactor, float)
    if not visual.defined:
        factor = np.array([PLAIN / 255] * 3 + [1.0])
    elif material.baseColorTexture is not None and "kd" not in getattr(visual.material, "kwargs", {"kd": 0}):
        factor = np.ones(4)
    material.baseColorFactor = [*_linear(factor[:3]), factor[3]]
    if primitive.color_0 is not None:
        primitive.color_0 = np.concatenate([_linear(primitive.color_0[:, :3]), primitive.color_0[:, 3:]], axis=1)


def _sample(drawn: pyrender.Scene, path: Path) -> None:
    """Makes textures repeat as the first sampler of a glTF file says."""
    data = path.read_bytes()
    samplers = json.loads(data).get("samplers", []) if path.suffix == ".gltf" else []
    for node in drawn.mesh_nodes if samplers else ():
        for primitive in node.mesh.primitives:
            texture = primitive.material.baseColorTexture
            if texture is not None:
                texture.sampler.wrapS = samplers[0].get("wrapS", texture.sampler.wrapS)
                texture.sampler.wrapT = samplers[0].get("wrapT", texture.sampler.wrapT)


def _linear(displayed: Any) -> NDArray[np.float64]:
    values = np.asarray(displayed, float)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


if __name__ == "__main__":
    main()
