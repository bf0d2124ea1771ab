"""Everything of a finished job that another program can use, file by file, into a folder or a zip file."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files as resources
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np
from PIL import Image
from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load

from scene_attack.errors import InvalidRequest
from scene_attack.export.glb import scene_glb
from scene_attack.export.parameters import as_colors, light_maps, normal_maps, openexr, parameter_table, write_exr
from scene_attack.export.report import Files, readme, report
from scene_attack.export.scene_values import carried, scene_values
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.shape import bent
from scene_attack.runs.exported_targets import exported_targets, write_targets
from scene_attack.runs.prepare import lit_by_map, resolved_scene
from scene_attack.runs.result import PERTURBATION, RESULT, Result
from scene_attack.runs.spec import JobSpec, job_name, parse
from scene_attack.scenes.exported_assets import write_assets
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene

_COMPRESSED = (".png", ".jpg", ".exr", ".npz", ".sh3f", ".zip")


@contextmanager
def zipped(file: BinaryIO, folder: str) -> Iterator[Callable[[str, bytes], None]]:
    """Yields a function that adds a file to a zip file under `folder`; the same files give the same bytes."""
    with ZipFile(file, "w") as archive:

        def write(name: str, data: bytes) -> None:
            entry = ZipInfo(f"{folder}/{name}", (1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data, ZIP_STORED if name.endswith(_COMPRESSED) else ZIP_DEFLATED)

        yield write


def into_folder(folder: Path) -> Callable[[str, bytes], None]:
    """A function that writes a file into a folder, which is made; so are the folders of the file's path in it."""
    folder.mkdir(parents=True, exist_ok=True)

    def write(name: str, data: bytes) -> None:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)

    return write


STOCK = ("render_exported.py", "mesh.vert", "mesh.frag")
"""Names of the files that draw a `.glb` of the bundle with trimesh and pyrender."""
WHICH = ("before", "after")

Write = Callable[[str, bytes], None]


@dataclass(frozen=True)
class Finished:
    """A finished job: its result, its spec as it ran, its scene with the assets of today, and its perturbation."""

    name: str
    """The name of its scene or question."""
    result: Result
    spec: JobSpec
    scene: ResolvedScene
    perturbation: Parameters

    @property
    def lit_by_map(self) -> bool:
        """Whether the environment map is the image's light."""
        return lit_by_map(self.spec)

    def glb(self, which: str) -> bytes:
        """The scene "before" or "after" the attack as a binary glTF file."""
        renderer = self.spec.attack.renderer
        groups = carried(renderer) if which == "after" else ()
        changes = {group: change for group, change in self.perturbation.items() if group in groups}
        scene = bent(self.scene, changes) if renderer == TORCH.name else self.scene
        bent_meshes = bool({"bump", "shape"} & changes.keys()) and renderer == TORCH.name
        values = scene_values(scene, changes)
        return scene_glb(scene, values, self.lit_by_map, f"environment_{which}.exr", not bent_meshes)


def read_finished(files: Files, library: Library) -> Finished:
    """Raises InvalidRequest("result") if a file is missing or damaged, and as `resolve` does for missing assets."""
    try:
        result = Result.model_validate_json(files[RESULT]())
        perturbation = load(files[PERTURBATION]())
    except KeyError as error:
        raise InvalidRequest("result", f"it has no result: there is no {error.args[0]}") from error
    except (OSError, ValidationError, ValueError, SafetensorError) as error:
        raise InvalidRequest("result", f"its result cannot be read: {error}") from error
    spec = parse(result.spec)
    if missing := [group for group in spec.attack.groups if group not in perturbation]:
        raise InvalidRequest("result", f"its {PERTURBATION} has no {', '.join(missing)}")
    if not all(change.isfinite().all() for change in perturbation.values()):
        raise InvalidRequest("result", f"its {PERTURBATION} has values that are not finite")
    ordered = {group: perturbation[group] for group in spec.attack.groups}  # the file's order is that of a hash map
    scene = resolved_scene(spec, library)
    return Finished(job_name(result.spec, scene.titles), result, spec, scene, ordered)


def write_bundle(files: Files, library: Library, write: Write, job: str | None = None) -> None:
    """Calls `write` with the path and the bytes of each file of the bundle. Raises as `read_finished` does. Draws with
    OpenGL for jobs of the torch renderer."""
    done = read_finished(files, library)
    if done.lit_by_map:
        openexr()  # before half of the files are written
    written: list[str] = []

    def put(name: str, data: bytes) -> None:
        written.append(name)
        write(name, data)

    for name, read in sorted(files.items()):
        put(name, read())
    put("request.json", _json(done.result.spec))
    for which in WHICH:
        put(f"scene_{which}.glb", done.glb(which))
    if done.lit_by_map:
        _write_maps(done, put)
    else:
        for name in STOCK:
            put(name, resources("scene_attack.export").joinpath("stock", name).read_bytes())
    normals = ("normals_before.npy", "normals_after.npy")
    of_groups = {
        "normals": normals,
        "bump": (*normals, "scene_before.glb", "scene_after.glb"),
        "shape": (*normals, "scene_before.glb", "scene_after.glb"),
        "paint": ("paint.png",),
        "illumination": ("environment_before.exr", "environment_after.exr"),
        "illumination_rgb": ("environment_before.exr", "environment_after.exr"),
        "lamp": ("environment_before.exr", "environment_after.exr"),
        "image": ("original.png", "attacked.png"),
    }
    table = parameter_table(done.scene, done.spec.attack.renderer, done.perturbation, of_groups)
    put("parameters.json", _json(table.model_dump(mode="json")))
    write_assets(done.spec.scene, library, put)
    targets = exported_targets(done.result, done.spec)
    write_targets(targets, put)
    put("report.html", report(done.result, done.name, table, files, job).encode())
    put("README.md", readme(done.result, done.name, done.spec, done.scene, written, targets, job).encode())


def _write_maps(done: Finished, put: Write) -> None:
    attacked = done.perturbation if done.spec.attack.renderer == TORCH.name else {}
    light, normals = light_maps(done.scene, attacked), normal_maps(done.scene, attacked)
    with TemporaryDirectory() as folder:  # OpenEXR writes to paths alone
        path = Path(folder) / "map.exr"
        for which in WHICH:
            credit = "; ".join(done.scene.credits(lit_by_map=True))
            write_exr(getattr(light, which), path, f"radiance after exposure, linear display units. {credit}")
            put(f"environment_{which}.exr", path.read_bytes())
    for which in WHICH:
        values, buffer = getattr(normals, which), BytesIO()
        np.save(buffer, values)
        put(f"normals_{which}.npy", buffer.getvalue())
        buffer = BytesIO()
        Image.fromarray(as_colors(values)).save(buffer, format="PNG")
        put(f"normals_{which}.png", buffer.getvalue())


def _json(value: object) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()
