"""Compares our images of models that other people made with those of stock pyrender. Writes results/own_meshes.json and
docs/stock-pyrender.md.

The models are of the tests of trimesh and assimp, in eight formats, with textures in other files, vertex colours and
the inputs of glTF materials: clone github.com/mikedh/trimesh and github.com/assimp/assimp into a folder and give it as
`--models`. A model is added to a library as an upload is, with the files beside it that it names.

Both renderers draw it under one directional light without ambient light, as in `benchmarks.gltf_materials`. What is no
glTF file is drawn as a dielectric of roughness 1 by both. Where the mean difference over the covered pixels reaches 2
of 255, stock pyrender draws the model again with what it leaves out put right: `mended`, see `benchmarks.stock_meshes`.
`used` and `notes` are what the upload says.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import own_meshes_page
from benchmarks.gltf_materials import LIGHTS, LIMIT, Image, View, difference
from benchmarks.report import RESULTS, save
from client.local_meshes import bundle_at
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.description import SceneObject
from services.scenes.library import Library
from services.scenes.mesh import FIT_RADIUS
from services.scenes.resolve import resolve
from services.scenes.view import camera_to_world

MODELS = (
    "trimesh/models/fuze.obj",
    "trimesh/models/capsule.obj",
    "assimp/test/models/OBJ/spider.obj",
    "trimesh/models/fuze.ply",
    "trimesh/models/reference.ply",
    "trimesh/models/featuretype.STL",
    "trimesh/models/ballA.off",
    "assimp/test/models/glTF2/BoxTextured-glTF/BoxTextured.gltf",
    "assimp/test/models/glTF2/ClearCoat-glTF/ClearCoatTest.gltf",
    "trimesh/models/TestScene.gltf",
    "trimesh/models/CesiumMilkTruck.glb",
    "trimesh/models/AlphaBlendModeTest.glb",
    "assimp/test/models/Collada/duck.dae",
    "assimp/test/models/Collada/kwxport_test_vcolors.dae",
    "trimesh/models/featuretype.3MF",
    "assimp/test/models/3MF/box.3mf",
)
GLTF = (".gltf", ".glb")
SCENE = View("-", "directional").scene
UPRIGHT = (".3mf",)
"""Formats in which +z is up; stock pyrender's model is turned."""


def main() -> None:
    """Renders and compares the models; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, required=True, help="the folder of both clones")
    parser.add_argument("--out", type=Path, default=RESULTS / "own_meshes.json")
    options = parser.parse_args()
    paths = [options.models / name for name in MODELS]
    rows, drawn, backend = [], [], ""
    for path in paths:
        row, image, backend = ours(path)
        rows.append(row)
        drawn.append(image)
    for mend in (False, True):
        asked = [k for k, row in enumerate(rows) if not mend or row["mean"] >= LIMIT]
        for k, other in zip(asked, stock([paths[k] for k in asked], mend=mend), strict=True):
            found = difference(drawn[k], other)
            rows[k] |= {"mended": found} if mend else found
    save(options.out, __doc__ or "", backend, None, limit=LIMIT, rows=rows)
    own_meshes_page.PAGE.write_text(own_meshes_page.page(), "utf-8")


def ours(path: Path) -> tuple[dict[str, Any], Image, str]:
    """What is said of a model, our image of it with stock pyrender's display curve, and the backend."""
    with tempfile.TemporaryDirectory() as directory:
        library = Library(Path(directory) / "cache", Path(directory) / "data")
        entry = library.add(bundle_at(path))
        surface = {} if path.suffix in GLTF else {"metallic": 0.0, "roughness": 1.0}
        placed = SceneObject.model_validate({"mesh": entry.name, **surface})
        renderer = PyrenderRenderer(resolve(SCENE.model_copy(update={"objects": (placed,)}), library))
    radiance, coverage = np.split(renderer.radiance({})[0].double().numpy(), [3], axis=-1)
    linear = np.divide(radiance, coverage, out=np.zeros_like(radiance), where=coverage > 0)
    shown: Image = np.rint(255 * coverage * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    said = {"model": path.name, "triangles": entry.triangles, "used": entry.used, "notes": entry.notes}
    return said, shown, renderer.backend


def stock(paths: list[Path], *, mend: bool) -> list[Image]:
    """Stock pyrender's images, uint8 [H, W, 3], all from one process. Raises CalledProcessError if it fails."""
    camera = SCENE.camera
    with tempfile.TemporaryDirectory() as directory:
        requests = [
            {
                "file": str(path),
                "out": str(Path(directory) / f"{k}.npy"),
                "matte": path.suffix not in GLTF,
                "z_up": path.suffix.lower() in UPRIGHT or b"Z_UP" in path.read_bytes(),
                "mend": mend,
                "size": camera.size,
                "field_of_view": camera.field_of_view,
                "pose": camera_to_world(camera).tolist(),
                "radius": FIT_RADIUS,
                "light": {"kind": "directional", "position": (0, 0, 0)} | LIGHTS["directional"],
            }
            for k, path in enumerate(paths)
        ]
        command = [sys.executable, "-m", "benchmarks.stock_meshes"]
        subprocess.run(command, input=json.dumps(requests), text=True, check=True, timeout=900)
        return [np.load(request["out"]) for request in requests]


if __name__ == "__main__":
    main()
