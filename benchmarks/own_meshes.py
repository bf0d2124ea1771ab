"""Compares our images of models that other people made with those of stock pyrender. Writes results/own_meshes.json and
docs/stock-pyrender.md.

The models are of the tests of trimesh and assimp, in eight formats, with textures in other files, vertex colours and
the inputs of glTF materials: clone github.com/mikedh/trimesh and github.com/assimp/assimp into a folder and give it as
`--models`. A model is added to a library as an upload is, with the files beside it that it names.

Both renderers draw it under one directional light without ambient light, as in `benchmarks.gltf_materials`. What is no
glTF file is drawn as a dielectric of roughness 1 by both. `used` and `notes` are what the upload says. Each figure has
the mean difference over the covered pixels, in 1/255, and the share of them that differ by more than 8.

Stock pyrender draws each model again with what it leaves out put right (`mended`), and then with what it does otherwise
done as ours does it (`alike`; see `benchmarks.stock_meshes`). `alike_fine` compares the two when both draw at eight
times the resolution and average light, so that samples and mipmaps no longer matter. `to_fine` is how far our image,
and stock pyrender's `mended` one, are each from their own one so averaged, and `light` the same for the mean light of
blocks of 8 × 8 pixels.
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
from benchmarks.fine_images import averaged, blocks, displayed, light
from benchmarks.gltf_materials import LIGHTS, LIMIT, Image, View, difference
from benchmarks.report import RESULTS, save
from client.local_meshes import bundle_at
from services.rendering.pyrender_renderer.renderer import PyrenderRenderer
from services.scenes.description import SceneObject
from services.scenes.library import Library
from services.scenes.mesh import FIT_RADIUS
from services.scenes.resolve import resolve
from services.scenes.view import camera_to_world
from services.settings import DEFAULTS

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
FINER = 8
"""How many times as large, in each direction, images are drawn that are averaged."""
KINDS = {"plain": 1, "mended": 1, "fine": FINER, "alike": 1, "alike_fine": FINER}
"""Stock pyrender's images, and how many times as large they are drawn; see above."""
BLOCK = 8
"""Pixels on the side of a block whose mean light is compared."""
SCENE = View("-", "directional").scene
UPRIGHT = (".3mf",)
"""Formats in which +z is up; stock pyrender's model is turned."""


def main() -> None:
    """Renders and compares the models; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", type=Path, required=True, help="the folder of both clones")
    parser.add_argument("--out", type=Path, default=RESULTS / "own_meshes.json")
    options = parser.parse_args()
    rows, backend = compared([options.models / name for name in MODELS])
    save(options.out, __doc__ or "", backend, None, limit=LIMIT, finer=FINER, block=BLOCK, rows=rows)
    own_meshes_page.PAGE.write_text(own_meshes_page.page(), "utf-8")


def compared(paths: list[Path]) -> tuple[list[dict[str, Any]], str]:
    """For each model what is said of it and how far its images are apart, and the backend."""
    rows = []
    own = [(ours(path), ours(path, FINER)[1]) for path in paths]
    for ((said, image, _), fine), other in zip(own, stock(paths), strict=True):
        pairs = {"ours": (image, fine), "stock": (other["mended"], other["fine"])}
        rows.append(
            said
            | difference(image, other["plain"])
            | {"mended": difference(image, other["mended"]), "alike": difference(image, other["alike"])}
            | {"alike_fine": difference(fine, other["alike_fine"])}
            | {"to_fine": {name: difference(*pair) for name, pair in pairs.items()}}
            | {"light": {name: difference(*(blocks(one, BLOCK) for one in pair)) for name, pair in pairs.items()}}
        )
    return rows, own[0][0][2]


def ours(path: Path, factor: int = 1) -> tuple[dict[str, Any], Image, str]:
    """What is said of a model, our image of it with stock pyrender's display curve, and the backend. The image is drawn
    `factor` times as large, and averaged."""
    with tempfile.TemporaryDirectory() as directory:
        library = Library(Path(directory) / "cache", Path(directory) / "data")
        entry = library.add(bundle_at(path, DEFAULTS))
        surface = {} if path.suffix in GLTF else {"metallic": 0.0, "roughness": 1.0}
        placed = SceneObject.model_validate({"mesh": entry.name, **surface})
        camera = SCENE.camera.model_copy(update={"size": _larger(factor)})
        scene = SCENE.model_copy(update={"objects": (placed,), "camera": camera})
        renderer = PyrenderRenderer(resolve(scene, library))
    radiance = renderer.radiance({})[0].double().numpy()
    said = {"model": path.name, "triangles": entry.triangles, "used": entry.used, "notes": entry.notes}
    return said, displayed(averaged(radiance, factor) if factor > 1 else radiance), renderer.backend


def stock(paths: list[Path]) -> list[dict[str, Image]]:
    """Stock pyrender's images of each model, uint8 [H, W, 3], by the name of their kind in KINDS; all from one process.

    Raises CalledProcessError if it fails.
    """
    camera = SCENE.camera
    asked = [(kind, k) for kind in KINDS for k in range(len(paths))]
    with tempfile.TemporaryDirectory() as directory:
        requests = [
            {
                "file": str(path := paths[k]),
                "out": str(Path(directory) / f"{kind}-{k}.npy"),
                "matte": path.suffix not in GLTF,
                "z_up": path.suffix.lower() in UPRIGHT or b"Z_UP" in path.read_bytes(),
                "mend": kind != "plain",
                "alike": kind.startswith("alike"),
                "size": _larger(KINDS[kind]),
                "field_of_view": camera.field_of_view,
                "pose": camera_to_world(camera).tolist(),
                "radius": FIT_RADIUS,
                "light": {"kind": "directional", "position": (0, 0, 0)} | LIGHTS["directional"],
            }
            for kind, k in asked
        ]
        command = [sys.executable, "-m", "benchmarks.stock_meshes"]
        subprocess.run(command, input=json.dumps(requests), text=True, check=True, timeout=1800)
        found: list[dict[str, Image]] = [{} for _ in paths]
        for (kind, k), request in zip(asked, requests, strict=True):
            found[k][kind] = _averaged(np.load(request["out"]), KINDS[kind])
    return found


def _averaged(drawn: Image, factor: int) -> Image:
    """The colours of an image [H, W, 4] of stock pyrender's, whose last value says where there is surface."""
    if factor == 1:
        return drawn[..., :3]
    return displayed(averaged(light(drawn[..., :3], drawn[..., 3] > 0), factor))


def _larger(factor: int) -> tuple[int, int]:
    height, width = SCENE.camera.size
    return factor * height, factor * width


if __name__ == "__main__":
    main()
