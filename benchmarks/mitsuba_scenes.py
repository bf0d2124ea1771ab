"""Compares scenes of several objects on a floor with Mitsuba 3 under direct light. Writes results/mitsuba_scenes.json.

Ten scenes, each of three to ten cubes, balls and cylinders of two sizes, rough dielectrics or smooth metals, on a floor
under three point lights, at 240×320, drawn by the pyrender renderer and by Mitsuba with two models of surfaces
(`benchmarks.mitsuba_direct`). Differences are of displayed values, in 1/255: means over pixels that show one surface
alone, whose neighbours show the same, and that see every light that they face. So shadows are left out.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.mitsuba_direct import MODELS
from benchmarks.report import RESULTS, save
from client.settings import settings_to_run
from services.rendering.color import to_display
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.pyrender_renderer.renderer import EXPOSURE, PyrenderRenderer
from services.scenes.description import Scene
from services.scenes.library import Library
from services.scenes.mesh import FIT_RADIUS
from services.scenes.resolve import PlacedMesh, ResolvedScene, resolve

SCENES = 10
SIZE = (240, 320)
SAMPLES = 16
LIMIT = 3.0
"""Largest mean difference of a scene, in 1/255."""
LIGHTS = [
    {"energy": 150.0, "position": (6.0, 6.0, 3.0)},
    {"energy": 60.0, "position": (-5.0, 5.0, 4.0)},
    {"energy": 80.0, "position": (1.0, 7.0, -6.0)},
]
COLORS = [
    (0.09, 0.09, 0.09),
    (0.42, 0.02, 0.02),
    (0.02, 0.07, 0.67),
    (0.01, 0.14, 0.01),
    (0.22, 0.08, 0.02),
    (0.22, 0.05, 0.53),
    (0.02, 0.67, 0.67),
    (1.0, 0.73, 0.03),
]
SHAPES = {"cube": (2**-0.5, 1.5**0.5), "sphere": (1.0, 1.0), "cylinder": (1.0, 2**0.5)}
"""By shape half its height and the radius of its bounding sphere, at size 1."""
METAL, RUBBER = {"metallic": 1.0, "roughness": 0.4}, {"metallic": 0.0, "roughness": 0.7}
Image = NDArray[np.float64]


def main() -> None:
    """Draws and compares the scenes; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS / "mitsuba_scenes.json")
    parser.add_argument("--scenes", type=int, default=SCENES)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as directory:
        settings = settings_to_run()
        library = Library(settings.cache_dir, Path(directory) / "data")
        scenes = [resolve(described(seed), library) for seed in range(options.scenes)]
        found = {model: mitsuba(scenes, model, Path(directory)) for model in MODELS}
    for seed, scene in enumerate(scenes):
        renderer = PyrenderRenderer(scene, tolerance="exact")
        own = renderer.radiance({})[0].double().numpy()
        inside = interior(scene) & (own[..., 3] == 1)
        for model, drawn in found.items():
            rows.append({"scene": seed, "model": model} | differences(scene, own[..., :3], drawn[seed], inside))
    backend = f"{renderer.backend}; Mitsuba {found['principled'][0]['version']}"
    save(options.out, __doc__ or "", backend, None, limit=LIMIT, rows=rows)


def described(seed: int) -> Scene:
    """A scene of the kind that CLEVR has, in its units of length."""
    random = np.random.default_rng(seed)
    things: list[dict[str, Any]] = []
    places: list[tuple[float, float, float]] = []
    for _ in range(random.integers(3, 11)):
        shape, radius = str(random.choice(list(SHAPES))), float(random.choice([0.35, 0.7]))
        half, bounding = SHAPES[shape]
        while True:
            x, z = (float(v) for v in random.uniform(-3, 3, 2))
            if all(hypot(x - a, z - b) > radius + other + 0.25 for a, b, other in places):
                break
        places.append((x, z, radius))
        pose = {"translation": (x, radius * half, z), "rotation": (0.0, float(random.uniform(0, 6)), 0.0)}
        surface = METAL if random.random() < 0.5 else RUBBER
        things.append(
            {
                "mesh": f"primitive/{shape}",
                "color": COLORS[random.integers(len(COLORS))],
                "scale": radius * bounding / FIT_RADIUS,
            }
            | pose
            | surface
        )
    camera = {"azimuth": float(random.uniform(0, 6)), "elevation": 0.49, "distance": 11.3, "field_of_view": 0.66}
    return Scene.model_validate(
        {
            "camera": camera | {"size": SIZE},
            "objects": things,
            "floor": {"size": 40.0} | RUBBER,
            "lights": {"ambient": 0.0, "points": LIGHTS, "environment": {"map": "uniform"}},
        }
    )


def mitsuba(scenes: list[ResolvedScene], model: str, directory: Path) -> list[dict[str, Any]]:
    """Mitsuba's images, from one process: `radiance`, `lit` and `version` of each. Raises CalledProcessError."""
    requests = []
    for seed, scene in enumerate(scenes):
        camera = scene.description.camera
        things = [thing(placed, directory / f"{seed}-{k}.ply") for k, placed in enumerate(scene.placed)]
        requests.append(
            {
                "size": camera.size,
                "eye": scene.eye.tolist(),
                "field_of_view": camera.field_of_view,
                "lights": LIGHTS,
                "things": things,
                "model": model,
                "samples": SAMPLES,
                "out": str(directory / f"{model}-{seed}.npz"),
            }
        )
    command = [sys.executable, "-m", "benchmarks.mitsuba_direct"]
    subprocess.run(command, input=json.dumps(requests), text=True, check=True, timeout=1800)
    return [dict(np.load(request["out"])) for request in requests]


def interior(scene: ResolvedScene) -> NDArray[np.bool_]:
    """Pixels that show one object, like all of their eight neighbours; bool [H, W]."""
    owner = rasterise(scene).object_index.numpy()
    inside = np.zeros(owner.shape, bool)
    inner = owner[1:-1, 1:-1]
    around = [owner[1 + i : owner.shape[0] - 1 + i, 1 + j : owner.shape[1] - 1 + j] for i, j in _NEIGHBOURS]
    inside[1:-1, 1:-1] = (inner >= 0) & np.all([other == inner for other in around], axis=0)
    return inside


_NEIGHBOURS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]


def differences(scene: ResolvedScene, own: Image, other: dict[str, Any], inside: NDArray[np.bool_]) -> dict[str, Any]:
    """Mean differences of displayed values, in 1/255: of the objects, of those of each surface, and of the floor."""
    owner = rasterise(scene).object_index.numpy()
    apart = 255 * np.abs(_shown(own) - _shown(other["radiance"])).mean(axis=-1)
    seen = inside & other["lit"]
    found: dict[str, Any] = {}
    for name, numbers in _parts(scene):
        chosen = seen & np.isin(owner, numbers)
        found[name] = round(float(apart[chosen].mean()), 3) if chosen.any() else None
    found["pixels"] = int((seen & (owner < len(scene.meshes))).sum())
    return found


def _parts(scene: ResolvedScene) -> Iterator[tuple[str, list[int]]]:
    things = list(enumerate(scene.description.objects))
    yield "objects", [k for k, _ in things]
    yield "metals", [k for k, thing in things if thing.metallic == METAL["metallic"]]
    yield "others", [k for k, thing in things if thing.metallic != METAL["metallic"]]
    yield "floor", [len(things)]


def _shown(radiance: Image) -> Image:
    return to_display(torch.as_tensor(EXPOSURE * radiance)).double().numpy()


def thing(placed: PlacedMesh, path: Path) -> dict[str, Any]:
    """Writes a mesh in world space as a PLY file; returns what Mitsuba needs to know of it."""
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
