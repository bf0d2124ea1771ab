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
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from benchmarks.report import RESULTS, save, shortest
from scene_attack.attacks.problem import generator
from scene_attack.rendering.color import to_display
from scene_attack.rendering.factory import build
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.protocol import Parameters, Renderer
from scene_attack.rendering.torch import dsbrdf
from scene_attack.rendering.torch.dsbrdf import MATERIAL_UNIT, colored_lobes
from scene_attack.rendering.torch.light import directions, illumination, solid_angles
from scene_attack.rendering.torch.table import to_vectors
from scene_attack.runs.environment import options_to_run
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve

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


@dataclass
class PlainShading:
    """The torch renderer's image of one object, one tensor operation after another, for autograd to differentiate.

    It shares the formulas of the material, the map and the display with the product, and none of its shading. All
    tensors have one dtype; P covered pixels, D directions.
    """

    pixels: Tensor
    coverage: Tensor
    base_color: Tensor
    colored: tuple[bool, ...]
    ground: Tensor
    towards: Tensor
    half: Tensor
    curves: Tensor
    power: Tensor

    @classmethod
    def of(cls, scene: ResolvedScene, dtype: torch.dtype) -> Self:
        """From a resolved scene."""
        gbuffer = rasterise(scene)
        to_camera = torch.as_tensor(scene.view, dtype=torch.float64)[:3, :3]
        light = illumination(torch.as_tensor(scene.environment))
        rows, cols = light.intensity.shape
        towards = directions(rows, cols) @ to_camera
        half, theta_d = dsbrdf.half_vectors(towards, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))
        coverage = gbuffer.coverage.flatten()
        pixels = coverage.nonzero()[:, 0]
        return cls(
            pixels,
            coverage[pixels, None].to(dtype),
            gbuffer.base_color.reshape(-1, 3)[pixels].to(dtype),
            colored_lobes(scene.description.objects[0].material),
            torch.tensor(scene.description.ground, dtype=dtype),
            towards.to(dtype),
            half.to(dtype),
            (dsbrdf.basis(theta_d) / MATERIAL_UNIT).to(dtype),
            (light.exposure * light.chroma.reshape(-1, 3).T * solid_angles(rows, cols)).to(dtype),
        )

    def colours(self, parameters: Parameters, part: slice) -> Tensor:
        """Displayed colours [p, 3] of a slice of the covered pixels."""
        pixels = self.pixels[part]
        normals = to_vectors(parameters["normals"].reshape(-1, 2)[pixels])
        log_kappa, gamma = dsbrdf.lobes(parameters["material"][0], self.curves)  # [3, lobes, D]
        cosine = (normals @ self.towards.T).clamp_min(0.0)
        log_half = (normals @ self.half.T).clamp_min(dsbrdf.COSINE_FLOOR).log()
        light = self.power * parameters["illumination"].flatten()
        channels = []
        for c in range(3):
            sent = 0.0
            for kappa, exponent, colored in zip(log_kappa[c], gamma[c], self.colored, strict=True):
                shaded = (dsbrdf.reflectance(log_half, kappa, exponent) * cosine) @ light[c]
                sent = sent + shaded * (self.base_color[part, c] if colored else 1.0)
            channels.append(sent)
        shown = to_display(torch.stack(channels, dim=-1))
        coverage = self.coverage[part]
        return coverage * shown + (1 - coverage) * self.ground

    def gradients(
        self, initial: Parameters, groups: tuple[str, ...], weights: Tensor, chunk: int
    ) -> tuple[Tensor, Parameters]:
        """Colours [P, 3] and the gradients of (colours · weights).sum(), `chunk` pixels at a time.

        Each chunk goes forward and backward at once, which is the best case: in an attack the weights are only known
        after the whole image, and chunks would have to be computed twice.
        """
        leaves = {g: v.detach().clone().requires_grad_(g in groups) for g, v in initial.items()}
        colours = []
        for start in range(0, len(self.pixels), chunk):
            part = slice(start, start + chunk)
            shown = self.colours(leaves, part)
            (shown * weights[part]).sum().backward()
            colours.append(shown.detach())
        return torch.cat(colours), {g: leaves[g].grad for g in groups if leaves[g].grad is not None}


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
    settings = options_to_run()
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
    settings = options_to_run()
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
