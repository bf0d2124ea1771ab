"""Draws glTF files with pyrender as it is installed, for `benchmarks.gltf_materials`. Runs in a process of its own: an
OpenGL context of pyrender's would end the one that our renderer draws with.

Reads a list of requests from standard input as JSON, each with `file` (a GLB), `size` [height, width], `field_of_view`
(vertical, radians), `pose` (camera to world [4][4]), `light` ({"kind", "energy", "position", "direction"}), `radius`
(the bounding sphere's, to which the model is scaled after its bounding box is moved to the origin), `mend` and `out`.
Writes uint8 [height, width, 3] to `out` (.npy): linear light, clamped and raised to 1 / 2.2 by pyrender.

With `mend`, what pyrender is known to leave out of a glTF file is put right before it draws, so that a reason can be
told from an excuse:
- faces below the alpha cutoff are cut out, for its shader knows no mask; the models' masks follow their faces;
- the backs of double-sided faces become faces of their own, for its shader does not turn normals over;
- mirrored nodes become meshes wound the other way, for it culls by the winding before they are mirrored;
- the root of the emissive factor is handed to it, for its shader multiplies by the factor twice;
- vertex colours beside a material are handed to it, for its loader drops them.
"""

import json
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyrender
import trimesh
from numpy.typing import NDArray


def main() -> None:
    """Draws the images that standard input asks for."""
    requests = json.load(sys.stdin)
    renderer = pyrender.OffscreenRenderer(1, 1)
    for request in requests:
        renderer.viewport_height, renderer.viewport_width = request["size"]
        color, _ = renderer.render(_scene(request))
        np.save(request["out"], color[..., :3])


def _scene(request: dict[str, Any]) -> pyrender.Scene:
    model = trimesh.load_scene(request["file"])
    points = model.to_geometry().vertices
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    scale = request["radius"] / np.linalg.norm(points - middle, axis=1).max()
    placement = np.diag([scale, scale, scale, 1.0])
    placement[:3, 3] = -scale * middle
    model.apply_transform(placement)
    colors = [mesh.visual.vertex_attributes.get("color") for mesh in model.geometry.values()]
    if request["mend"]:
        model = _mended(model)
    scene = pyrender.Scene.from_trimesh_scene(model, bg_color=(0, 0, 0, 0), ambient_light=(0, 0, 0))
    if request["mend"]:
        _hand_over(scene, colors)
    height, width = request["size"]
    camera = pyrender.PerspectiveCamera(yfov=request["field_of_view"], aspectRatio=width / height, znear=0.05, zfar=50)
    scene.add(camera, pose=np.array(request["pose"]))
    light, pose = _light(request["light"])
    scene.add(light, pose=pose)
    return scene


def _mended(model: trimesh.Scene) -> trimesh.Scene:
    """Masks, backs and mirrored nodes as geometry; every mesh where its node is."""
    meshes = []
    for mesh in model.dump():
        material = mesh.visual.material
        if material.alphaMode == "MASK":
            texels = np.array(material.baseColorTexture)[::-1]
            middle = np.asarray(mesh.visual.uv)[mesh.faces].mean(axis=1)
            column, row = (middle * texels.shape[1::-1]).astype(int).T
            mesh.update_faces(texels[row, column, 3] >= 255 * material.alphaCutoff)
            material.baseColorTexture = material.baseColorTexture.convert("RGB")
        meshes.append(mesh)
        if material.doubleSided:
            material.doubleSided = False
            back = mesh.copy()
            back.invert()
            meshes.append(back)
    return trimesh.Scene(meshes)


def _hand_over(scene: pyrender.Scene, colors: Sequence[NDArray[np.float32] | None]) -> None:
    """Emission and, of a model with one mesh, vertex colours."""
    for node in scene.mesh_nodes:
        [primitive] = node.mesh.primitives
        primitive.material.emissiveFactor = np.sqrt(primitive.material.emissiveFactor)
        if len(colors) == 1 and colors[0] is not None:
            primitive.color_0 = colors[0]


def _light(light: dict[str, Any]) -> tuple[pyrender.Light, NDArray[np.float64]]:
    """The light and its pose: pyrender's lights shine along their -z."""
    pose = np.eye(4)
    back = -np.array(light["direction"]) / np.linalg.norm(light["direction"])
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, light["position"]
    kinds = {
        "point": lambda: pyrender.PointLight(intensity=light["energy"]),
        "directional": lambda: pyrender.DirectionalLight(intensity=light["energy"]),
        "spot": lambda: pyrender.SpotLight(
            intensity=light["energy"], innerConeAngle=light["inner_angle"], outerConeAngle=light["outer_angle"]
        ),
    }
    return kinds[light["kind"]](), pose


if __name__ == "__main__":
    main()
