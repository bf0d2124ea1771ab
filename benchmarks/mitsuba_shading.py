"""Measures Mitsuba 3 shading a sphere under an environment map; prints JSON. benchmarks/shading.py runs it.

The scene is as similar to our shading problem as Mitsuba allows: an orthographic camera, a sphere with as many pixels,
the same environment map of 16×32 texels, a rough plastic, direct light only (the integrator prb at depth 2), and
gradients with respect to the map, the material's parameters and the mesh's normals and positions. Errors are those of
displayed values on the object's pixels, against Mitsuba's own image of many samples with other seeds.
"""

import argparse
import json
import os
import tempfile
import time
from math import pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.peers import reach
from scene_attack.rendering.color import to_display

LLVM = "/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1"
"""The LLVM library to load. Without the setting, Mitsuba may load another version on the machine, and abort."""
WANTED = ("data", "diffuse_reflectance", "alpha", "specular_reflectance", "vertex_normals", "vertex_positions")


def main() -> None:
    """Prints one JSON object; see benchmarks/shading.py."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", type=Path, help="the environment map, a .npy file of [rows, columns, 3]")
    parser.add_argument("--size", type=int, default=448)
    parser.add_argument("--pixels", type=int, default=60_000)
    parser.add_argument("--samples", type=int, nargs="+", default=[4, 16, 64, 256])
    parser.add_argument("--reference", type=int, default=4096)
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    os.environ.setdefault("DRJIT_LIBLLVM_PATH", LLVM)
    reach()
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(torch.get_num_threads())
    scene = mi.load_dict(_scene(mi, np.load(options.map), options.size, sqrt(4 * options.pixels / pi) / options.size))
    parameters = mi.traverse(scene)
    keys = [key for key in parameters.keys() if key.split(".")[-1] in WANTED or "reflectance" in key]  # noqa: SIM118
    reference = _averaged(mi, scene, options.reference)
    covered = reference.sum(axis=-1) > 0
    factor = 0.9 / reference.max()
    weights = mi.TensorXf(np.random.default_rng(0).standard_normal(reference.shape).astype(np.float32))

    def work(samples: int, seed: int) -> np.ndarray:
        for key in keys:
            dr.enable_grad(parameters[key])
        parameters.update()
        image = mi.render(scene, parameters, spp=samples, seed=seed)
        dr.backward(dr.sum(image * weights))
        gradients = [dr.grad(parameters[key]) for key in keys]
        dr.eval(image, *gradients)
        dr.sync_thread()
        return np.array(image)

    rows = []
    for samples in options.samples:
        work(samples, 0)  # compiles
        seconds, errors = [], []
        for seed in range(options.repeats):
            began = time.perf_counter()
            image = work(samples, seed)
            seconds.append(time.perf_counter() - began)
            error = (_display(factor * image) - _display(factor * reference))[covered]
            errors.append(float(np.sqrt(np.mean(error**2))))
        rows.append({"samples": samples, "seconds": min(seconds), "rms": float(np.mean(errors))})
    result = {
        "mitsuba": mi.__version__,
        "variant": mi.variant(),
        "gradients": keys,
        "object_pixels": int(covered.sum()),
        "reference_samples": options.reference,
        "rows": rows,
    }
    print(json.dumps(result))


def _averaged(mi: Any, scene: Any, samples: int, step: int = 256) -> np.ndarray:
    """The mean of renderings of `step` samples, which is as many as memory holds at once."""
    seeds = range(1000, 1000 + samples // step)
    return np.mean([np.array(mi.render(scene, spp=step, seed=seed)) for seed in seeds], axis=0)


def _display(linear: np.ndarray) -> np.ndarray:
    return to_display(torch.as_tensor(linear)).numpy()


def _scene(mi: Any, sky: np.ndarray, size: int, radius: float) -> dict[str, Any]:
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 2, "hide_emitters": True},
        "sensor": {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 5], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
        "light": {"type": "envmap", "bitmap": mi.Bitmap(sky.astype(np.float32))},
        "object": _sphere(radius) | {"material": {"type": "roughplastic", "alpha": 0.3}},
    }


def _sphere(radius: float, rows: int = 40, columns: int = 64) -> dict[str, Any]:
    """A mesh of about 5,000 triangles, with a normal at every vertex, as a file that Mitsuba reads."""
    polar, azimuth = np.meshgrid(np.linspace(0, pi, rows + 1), np.linspace(0, 2 * pi, columns + 1), indexing="ij")
    normals = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1)
    lines = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in (radius * normals).reshape(-1, 3)]
    lines += [f"vn {x:.7f} {y:.7f} {z:.7f}" for x, y, z in normals.reshape(-1, 3)]
    for row in range(rows):
        for column in range(columns):
            a = row * (columns + 1) + column + 1
            b, c, d = a + 1, a + columns + 1, a + columns + 2
            lines += [f"f {a}//{a} {c}//{c} {d}//{d}", f"f {a}//{a} {d}//{d} {b}//{b}"]
    path = Path(tempfile.mkdtemp()) / "sphere.obj"
    path.write_text("\n".join(lines), "utf-8")
    return {"type": "obj", "filename": str(path)}


if __name__ == "__main__":
    main()
