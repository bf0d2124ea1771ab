"""Compares ten CLEVR-style scenes with Mitsuba 3, direct light only. Writes results/mitsuba_clevr.json.

The scenes are those of `services.scenes.clevr` (seed 7), with floor, given surfaces and shadows. The pyrender renderer
is compared under the three point lights, with a Lambertian body and a rough dielectric or rough conductor in Mitsuba;
its ambient light, which is no light source, is 0, and pixels in penumbrae are left out: Mitsuba's lights are points.
The torch renderer is compared under the map `lights`, 16×32 texels, and Mitsuba under the same map at 128×256, with the
BSDFs that the presets are fitted to; all pixels count, as with lights from all around all are in some penumbra.

Differences are of displayed values, in 1/255: means over pixels that show one surface alone, whose neighbours show the
same, of the objects, and of the floor.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.report import RESULTS, save
from client.settings import settings_to_run
from services.rendering.color import to_display
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.pyrender_renderer.renderer import EXPOSURE, PyrenderRenderer
from services.rendering.torch_renderer.light import illumination
from services.rendering.torch_renderer.renderer import TorchRenderer
from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import generate
from services.scenes.library import Library
from services.scenes.resolve import PlacedMesh, ResolvedScene, resolve

SCENES, SEED = 10, 7
SAMPLES = {"layers": 16, "presets": 10}
"""Samples of a pixel for each point light, and 1/64 of those under the map."""
LIMIT = 3.0
"""Largest mean difference of a scene's objects, in 1/255."""


def main() -> None:
    """Draws and compares the scenes; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS / "mitsuba_clevr.json")
    parser.add_argument("--scenes", type=int, default=SCENES)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as directory:
        settings = settings_to_run()
        library = Library(settings.cache_dir, Path(directory) / "data")
        scenes = [resolve(describe(generate(SEED, k)), library) for k in range(options.scenes)]
        under_points = [_requested(scene, k, Path(directory)) for k, scene in enumerate(scenes)]
        under_maps = [_under_map(scene, k, Path(directory)) for k, scene in enumerate(scenes)]
        drawn = _drawn(under_points + under_maps)
        version = str(drawn[0]["version"])
        for k, scene in enumerate(scenes):
            rows.append({"scene": k, "renderer": "pyrender"} | _pyrender(scene, drawn[k]))
            rows.append({"scene": k, "renderer": "torch"} | _torch(scene, drawn[options.scenes + k]))
            print(rows[-2:], flush=True)
    backend = f"{PyrenderRenderer(scenes[0]).backend}; torch {torch.__version__}; Mitsuba {version}"
    save(options.out, __doc__ or "", backend, SEED, limit=LIMIT, rows=rows)


def _requested(scene: ResolvedScene, number: int, directory: Path) -> dict[str, Any]:
    description = scene.description
    assert description.shadows is not None
    return {
        "size": description.camera.size,
        "eye": scene.eye.tolist(),
        "field_of_view": description.camera.field_of_view,
        "lights": [light.model_dump() for light in description.lights.points],
        "softness": description.shadows.softness,
        "things": [_thing(placed, directory / f"{number}-{k}.ply") for k, placed in enumerate(scene.placed)],
        "model": "layers",
        "samples": SAMPLES["layers"],
        "out": str(directory / f"points-{number}.npz"),
    }


def _under_map(scene: ResolvedScene, number: int, directory: Path) -> dict[str, Any]:
    """The same scene under the map that the torch renderer's is made of, scaled to its exposure."""
    light = illumination(torch.as_tensor(scene.environment))
    own = scene.environment.astype(np.float64)
    scale = light.exposure * float(light.intensity.sum()) / float((own @ (0.2126, 0.7152, 0.0722)).sum())
    assert scene.source_map is not None
    np.save(directory / f"map-{number}.npy", scale * scene.source_map)
    request = _requested(scene, number, directory) | {"map": str(directory / f"map-{number}.npy")}
    del request["lights"]
    own = {"model": "presets", "samples": SAMPLES["presets"], "out": str(directory / f"map-{number}.npz")}
    return request | own


def _drawn(requests: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mitsuba's images, from one process. Raises CalledProcessError."""
    command = [sys.executable, "-m", "benchmarks.mitsuba_direct"]
    subprocess.run(command, input=json.dumps(requests), text=True, check=True, timeout=3600)
    return [dict(np.load(request["out"])) for request in requests]


def _pyrender(scene: ResolvedScene, other: dict[str, Any]) -> dict[str, Any]:
    lights = scene.description.lights.model_copy(update={"ambient": 0.0})
    dark = scene.description.model_copy(update={"lights": lights})
    own = PyrenderRenderer(replace(scene, description=dark), tolerance="exact").radiance({})[0].double().numpy()
    apart = _shown(EXPOSURE * own[..., :3]) - _shown(EXPOSURE * other["radiance"])
    return _means(scene, apart, _interior(scene) & other["sharp"] & (own[..., 3] == 1))


def _torch(scene: ResolvedScene, other: dict[str, Any]) -> dict[str, Any]:
    own = TorchRenderer(scene, rasterise(scene), tolerance="exact").render({})[0].numpy()
    return _means(scene, own - _shown(other["radiance"]), _interior(scene))


def _means(scene: ResolvedScene, apart: np.ndarray, chosen: np.ndarray) -> dict[str, Any]:
    owner = rasterise(scene).object_index.numpy()
    off, count = 255 * np.abs(apart).mean(axis=-1), len(scene.meshes)
    things = scene.description.objects
    means: dict[str, Any] = {}
    for name, numbers in (
        ("objects", list(range(count))),
        ("metals", [k for k in range(count) if things[k].material == "metal"]),
        ("rubbers", [k for k in range(count) if things[k].material == "rubber"]),
        ("floor", [count]),
    ):
        own = chosen & np.isin(owner, numbers)
        means[name] = round(float(off[own].mean()), 3) if own.any() else None
    means["pixels"] = int((chosen & (owner < count)).sum())
    return means


def _shown(radiance: np.ndarray) -> np.ndarray:
    return to_display(torch.as_tensor(radiance)).double().numpy()


def _interior(scene: ResolvedScene) -> np.ndarray:
    """Pixels that show one object, like all of their eight neighbours; bool [H, W]."""
    owner = rasterise(scene).object_index.numpy()
    inside = np.zeros(owner.shape, bool)
    blocks = np.lib.stride_tricks.sliding_window_view(owner, (3, 3))
    inside[1:-1, 1:-1] = (blocks == owner[1:-1, 1:-1, None, None]).all(axis=(-2, -1)) & (owner[1:-1, 1:-1] >= 0)
    return inside


def _thing(placed: PlacedMesh, path: Path) -> dict[str, Any]:
    """Writes a mesh in world space as a PLY file; returns Mitsuba's description of it."""
    [part] = placed.mesh.parts
    turn, move = placed.model[:3, :3], placed.model[:3, 3]
    vertices = part.vertices.astype(np.float64) @ turn.T + move
    normals = part.normals.astype(np.float64) @ np.linalg.inv(turn)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
    header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    header += f"element face {len(part.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = np.zeros(len(part.faces), [("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, part.faces
    path.write_bytes(header.encode() + np.hstack([vertices, normals]).astype("<f4").tobytes() + rows.tobytes())
    described = placed.described
    return {
        "file": str(path),
        "color": described.color,
        "metallic": described.metallic,
        "roughness": described.roughness,
        "preset": described.material,
    }


if __name__ == "__main__":
    main()
