"""Compares our images of glTF materials with those of stock pyrender. It writes gltf_materials.json and gltf.md.

Both renderers draw the ten models of `benchmarks.gltf_models` under a point light, a directional light and a spot
light, without ambient light. Stock pyrender reads the file by trimesh, clamps linear light to [0,1], raises it to
1 / 2.2 and rounds it to 8 bits; the same curve is applied to our image, over the same black ground. Differences are
means over the pixels that either image covers, in 1/255. If the mean reaches 2, stock pyrender draws the model again
with corrections of its known omissions (`mended`, see `benchmarks.stock_pyrender`).
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gltf_models import MODELS, two_uv_sets
from benchmarks.page import load, provenance
from benchmarks.report import RESULTS, save
from benchmarks.stale import ROOT
from scene_attack.rendering.opengl import context
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Camera, Lights, Scene, SceneObject
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import resolve
from scene_attack.scenes.view import camera_to_world
from scene_attack_accuracy.tables import table

PAGE = ROOT / "docs" / "reports" / "gltf.md"
SIZE = (256, 256)
LIMIT = 2.0
"""Mean difference, in 1/255, at and above which a reason must be given."""
PLACE, AXIS = (1.2, 1.6, 1.5), (-1.2, -1.6, -1.5)
LIGHTS: dict[str, dict[str, Any]] = {
    "point": {"energy": 10.0, "position": PLACE},
    "directional": {"energy": 2.0, "direction": AXIS},
    "spot": {"energy": 10.0, "position": PLACE, "direction": AXIS, "inner_angle": 0.1, "outer_angle": 0.35},
}
REASONS = {
    "emissive": "Stock pyrender's shader multiplies the emission by its factor twice.",
    "masked": "Stock pyrender's shader has no alpha cutoff and its loader blends every material; the backs of "
    "double-sided faces keep the normal of the front, and are dark. glTF cuts out what is below the cutoff and turns "
    "the normal over.",
    "vertex-coloured": "Stock pyrender's loader drops vertex colours beside a material. Handed to it, they also tint "
    "the highlight, because its shader multiplies the reflected light by them; in glTF they belong to the base colour.",
    "nested transforms": "Stock pyrender does not turn the winding of a mirrored node over, and shows its inside.",
    "two UV sets": "Stock pyrender looks every texture up at the first set of texture coordinates.",
}
"""The reason for which the difference of a model reaches the limit."""
Image = NDArray[np.uint8]
_FIELDS = {"point": "points", "directional": "directional", "spot": "spots"}


@dataclass(frozen=True)
class View:
    """A model of MODELS under a light of LIGHTS; `mend` says whether stock pyrender's omissions are corrected."""

    model: str
    light: str
    mend: bool = False

    @property
    def glb(self) -> bytes:
        """The bytes of the GLB file."""
        # Stock pyrender ignores a second set of texture coordinates, so the correction bakes it into the first.
        return two_uv_sets(baked=True) if self.mend and self.model == "two UV sets" else MODELS[self.model]()

    @property
    def scene(self) -> Scene:
        """The description of the scene around the model, without the mesh's name."""
        lights = {"ambient": 0.0, "points": (), "environment": {"map": "uniform"}}
        return Scene(
            camera=Camera(size=SIZE),
            objects=(SceneObject(mesh="-"),),
            lights=Lights.model_validate(lights | {_FIELDS[self.light]: (LIGHTS[self.light],)}),
            ground=(0.0, 0.0, 0.0),
        )


def main() -> None:
    """Renders and compares the models; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS / "gltf_materials.json")
    options = parser.parse_args()
    views = [View(model, light) for model in MODELS for light in LIGHTS]
    drawn = [ours(view) for view in views]
    apart = [difference(image, reference) for (image, _), reference in zip(drawn, stock(views), strict=True)]
    rows = [{"model": view.model, "light": view.light} | errors for view, errors in zip(views, apart, strict=True)]
    far = [k for k, row in enumerate(rows) if float(row["mean"]) >= LIMIT]
    again = stock([View(views[k].model, views[k].light, mend=True) for k in far])
    for k, other in zip(far, again, strict=True):
        rows[k]["mended"] = difference(drawn[k][0], other)
    save(options.out, __doc__ or "", drawn[0][1], None, limit=LIMIT, rows=rows)
    PAGE.write_text(page(), "utf-8")


def ours(view: View) -> tuple[Image, str]:
    """Our image with stock pyrender's display curve, uint8 [H, W, 3], and the backend."""
    with tempfile.TemporaryDirectory() as directory:
        library = Library(Path(directory) / "cache", Path(directory) / "data")
        mesh = library.add_mesh(view.glb, "glb").name
        scene = resolve(view.scene.model_copy(update={"objects": (SceneObject(mesh=mesh),)}), library)
        renderer = PyrenderRenderer(scene)
    radiance, coverage = np.split(renderer.radiance({})[0].double().numpy(), [3], axis=-1)
    linear = np.divide(radiance, coverage, out=np.zeros_like(radiance), where=coverage > 0)
    shown: Image = np.rint(255 * coverage * np.clip(linear, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return shown, renderer.backend


def stock(views: Sequence[View]) -> list[Image]:
    """Stock pyrender's images, uint8 [H, W, 3], all from one process. Raises CalledProcessError if it fails."""
    if not views:
        return []
    with tempfile.TemporaryDirectory() as directory:
        requests = [_request(view, Path(directory) / str(k)) for k, view in enumerate(views)]
        command = [sys.executable, "-m", "benchmarks.stock_pyrender"]
        context.choose_platform()  # in the environment, which the process inherits
        subprocess.run(command, input=json.dumps(requests), text=True, check=True, timeout=300)
        return [np.load(request["out"]) for request in requests]


def difference(one: Image, other: Image) -> dict[str, float]:
    """Over pixels that either image covers: the mean difference in 1/255, the share above 8/255, and their number."""
    covered = (one > 0).any(axis=-1) | (other > 0).any(axis=-1)
    apart = np.abs(one.astype(int) - other.astype(int))[covered]
    return {
        "mean": round(float(apart.mean()), 3),
        "share_beyond_8": round(float((apart.max(axis=-1) > 8).mean()), 4),
        "pixels": int(covered.sum()),
    }


def _request(view: View, path: Path) -> dict[str, Any]:
    path.with_suffix(".glb").write_bytes(view.glb)
    camera = view.scene.camera
    return {
        "file": str(path.with_suffix(".glb")),
        "out": str(path.with_suffix(".npy")),
        "mend": view.mend,
        "size": camera.size,
        "field_of_view": camera.field_of_view,
        "pose": camera_to_world(camera).tolist(),
        "radius": FIT_RADIUS,
        "light": {"kind": view.light, "position": PLACE, "direction": AXIS} | LIGHTS[view.light],
    }


def page() -> str:
    """docs/reports/gltf.md with the table and the provenance at its end written from the result."""
    result = load("gltf_materials")
    models: dict[str, dict[str, Any]] = {}
    for row in result["rows"]:
        models.setdefault(row["model"], {})[row["light"]] = row
    cells: dict[str, Callable[[str], str]] = {"model": str}
    cells |= {f"{light}>": lambda model, light=light: f"{models[model][light]['mean']:.2f}" for light in LIGHTS}
    cells["with the reason put right>"] = lambda model: ", ".join(
        f"{row['mended']['mean']:.2f}" for row in models[model].values() if "mended" in row
    )
    cells["reason"] = lambda model: (
        REASONS[model] if max(row["mean"] for row in models[model].values()) >= result["limit"] else ""
    )
    words = PAGE.read_text("utf-8").split("| model |")[0]
    return words + "\n\n".join([table(cells, models), provenance(result)]) + "\n"


if __name__ == "__main__":
    main()
