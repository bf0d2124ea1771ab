"""Compares our shading with plain torch and Mitsuba 3, forward and backward. Writes results/shading.json.

One object of about 60,000 pixels at 448² under a map of 512 directions, 3 lobes × RGB. Each line is an image and the
gradients of a weighted sum of its values. Errors are against plain torch in float64, of displayed values on the
object's pixels (largest and root mean square), and of each group's gradient (norm of the difference over norm), at the
scene's own parameters and with the attacked groups moved. Mitsuba shades a problem of the same size, and is measured
against its own image of many samples.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.plain_shading import PlainShading
from benchmarks.report import RESULTS, save, shortest
from client.settings import settings_to_run
from services.attacks.problem import generator
from services.pipeline.spec import parse
from services.rendering.factory import build
from services.rendering.protocol import Parameters, Renderer
from services.scenes.library import Library
from services.scenes.resolve import ResolvedScene, resolve

GROUPS: dict[str, tuple[str, ...]] = {
    "all": ("normals", "illumination", "material"),
    "normals": ("normals",),
    "illumination": ("illumination",),
    "material": ("material",),
    "normals, illumination": ("normals", "illumination"),
    "normals, material": ("normals", "material"),
    "illumination, material": ("illumination", "material"),
}
MOVES = {"normals": 0.05, "illumination": 1.0, "material": 3.0}
"""Standard deviation of the random change of each group at which errors are measured too, in the group's units."""
CHUNK = 1024
Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """Parameters at which errors are measured, with the reference image and gradients."""

    name: str
    parameters: Parameters
    colours: Tensor
    gradients: Parameters


def main() -> None:
    """Runs the comparison; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mesh", default="primitive/sphere")
    parser.add_argument("--material", default="plastic")
    parser.add_argument("--scale", type=float, default=0.73, help="size of the object (default 0.73: 60,000 pixels)")
    parser.add_argument("--tolerance", type=float, default=1e-3)
    parser.add_argument("--repeats", type=int, default=5, help="repeats of the fast lines (default 5)")
    parser.add_argument("--no-mitsuba", action="store_true")
    parser.add_argument("--out", type=Path, default=RESULTS / "shading.json")
    options = parser.parse_args()
    settings = settings_to_run()
    torch.set_num_threads(settings.threads)
    scene = _scene(options)
    truth = PlainShading.of(scene, torch.float64)
    rows = [_plain(scene, "one shot", None, 1), _plain(scene, "chunked", CHUNK, 2)]
    eager = rows[1]["seconds"]
    for groups in GROUPS.values():
        cases = _cases(truth, build(scene, "torch", groups=groups).initial(), groups)
        for tolerance in (options.tolerance, "exact"):
            renderer = build(scene, "torch", groups=groups, tolerance=tolerance)
            rows.append(_ours(renderer, truth, groups, cases, options.repeats if tolerance != "exact" else 1))
    for row in rows:
        row["times faster than chunked eager"] = eager / row["seconds"]
        print(_line(row), flush=True)
    mitsuba = None if options.no_mitsuba else _mitsuba(scene, len(truth.pixels))
    for row in mitsuba["rows"] if mitsuba else ():
        row["times slower than ours, all groups"] = row["seconds"] / rows[2]["seconds"]
        row["rms / ours"] = row["rms"] / rows[2]["rms"]
        print("Mitsuba 3, " + _line(row))
    save(options.out, __doc__ or "", renderer.backend, 0, pixels=len(truth.pixels), rows=rows, mitsuba=mitsuba)


def _scene(options: argparse.Namespace) -> ResolvedScene:
    thing = {"mesh": options.mesh, "material": options.material, "scale": options.scale, "color": [0.8, 0.6, 0.4]}
    spec = parse({"scene": {"objects": [thing], "camera": {"size": [448, 448]}}})
    settings = settings_to_run()
    return resolve(spec.scene, Library(settings.cache_dir, settings.data_dir))


def _plain(scene: ResolvedScene, name: str, chunk: int | None, repeats: int) -> Row:
    plain = PlainShading.of(scene, torch.float32)
    initial = build(scene, "torch").initial()
    weights = _weights(len(plain.pixels)).float()
    at_once = chunk or len(plain.pixels)
    try:
        seconds = shortest(lambda: plain.gradients(initial, GROUPS["all"], weights, at_once), repeats, 1)
    except (MemoryError, RuntimeError) as error:
        return {"method": f"eager torch, {name}", "groups": "all", "seconds": float("inf"), "failed": str(error)[:200]}
    return {"method": f"eager torch, {name}", "groups": "all", "seconds": seconds}


def _cases(truth: PlainShading, initial: Parameters, groups: tuple[str, ...]) -> list[Case]:
    """The scene's own parameters, and the attacked groups moved, with the results of plain torch in float64."""
    moved = {g: v + (MOVES[g] * _random(g, v) if g in groups else 0.0) for g, v in initial.items()}
    moved["illumination"] = moved["illumination"].clamp_min(0.0)
    weights = _weights(len(truth.pixels))
    return [
        Case(name, at, *truth.gradients({g: v.double() for g, v in at.items()}, groups, weights, CHUNK))
        for name, at in (("", initial), (" moved", moved))
    ]


def _ours(renderer: Renderer, truth: PlainShading, groups: tuple[str, ...], cases: list[Case], repeats: int) -> Row:
    weights = _weights(len(truth.pixels))
    seconds = shortest(lambda: _rendered(renderer, truth, cases[0].parameters, groups, weights), repeats)
    row = {"method": "ours", "groups": ", ".join(groups), "tolerance": renderer.plan.tolerance, "seconds": seconds}
    row["estimated"] = renderer.plan.error
    for case in cases:
        colours, gradients = _rendered(renderer, truth, case.parameters, groups, weights)
        error = colours.double() - case.colours
        row |= {f"max{case.name}": float(error.abs().max()), f"rms{case.name}": float(error.square().mean().sqrt())}
        for group in groups:
            off = (gradients[group].double() - case.gradients[group]).norm() / case.gradients[group].norm()
            row[f"gradient of {group}{case.name}"] = float(off)
    return row


def _rendered(
    renderer: Renderer, truth: PlainShading, at: Parameters, groups: tuple[str, ...], weights: Tensor
) -> tuple[Tensor, Parameters]:
    leaves = {g: at[g].clone().requires_grad_() for g in groups}
    image = renderer.render({g: leaf[None] for g, leaf in leaves.items()})[0]
    colours = image.reshape(-1, 3)[truth.pixels]
    gradients = torch.autograd.grad((colours * weights.to(colours.dtype)).sum(), list(leaves.values()))
    return colours.detach(), dict(zip(groups, gradients, strict=True))


def _weights(pixels: int) -> Tensor:
    return torch.randn(pixels, 3, generator=generator(0, "weights"), dtype=torch.float64)


def _random(group: str, like: Tensor) -> Tensor:
    return torch.randn(like.shape, generator=generator(0, "move", group), dtype=torch.float64).to(like.dtype)


def _mitsuba(scene: ResolvedScene, pixels: int) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        sky = Path(folder) / "sky.npy"
        np.save(sky, np.asarray(scene.environment))
        command = [sys.executable, "-m", "benchmarks.mitsuba_shading", str(sky), "--pixels", str(pixels)]
        done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        return {"failed": done.stderr[-500:], "rows": []}
    row: Row = json.loads(done.stdout.splitlines()[-1])
    return row


def _line(row: Row) -> str:
    return ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items())


if __name__ == "__main__":
    main()
