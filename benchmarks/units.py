"""Counts the pixels that the paper's learning rates truncate, for several units of L and m. Writes results/units.json.

The paper (section 4.1.1) reports 6.3, 1.6 and 0 truncated pixels for normals, illumination and material, over at most
120 steps that end at success. An attack in other units is an attack with the learning rate scaled, so one
build measures all.
"""

import argparse
import json
import platform
import statistics
import tempfile
from importlib.metadata import version
from pathlib import Path

from rich.progress import track

from benchmarks.views import right
from services.pipeline.execute import execute
from services.pipeline.outcome import success
from services.pipeline.result import Result
from services.pipeline.spec import JobSpec, parse
from services.rendering.torch_renderer.declaration import TORCH
from services.rendering.torch_renderer.units import ILLUMINATION_MEAN, MATERIAL_UNIT
from services.scenes.library import Library
from services.settings import settings

HERE = Path(__file__).parent
UNITS = {
    "normals": {1.0: 1.0},
    "illumination": {mean: ILLUMINATION_MEAN / mean for mean in (30.0, 20.0, 10.0, 5.0)},
    "material": {unit: MATERIAL_UNIT / unit for unit in (30.0, 10.0, 3.0)},
}
"""Group to {unit: factor on the learning rate}."""


def main() -> None:
    """Runs the calibration; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=12, help="views to attack (default 12)")
    parser.add_argument("--groups", nargs="+", default=list(UNITS), choices=list(UNITS))
    parser.add_argument("--out", type=Path, default=HERE / "results" / "units.json")
    options = parser.parse_args()
    library = Library(settings().cache_dir, settings().data_dir)
    scenes = list(right(library, options.views))
    cases = [(group, unit, factor) for group in options.groups for unit, factor in UNITS[group].items()]
    rows = []
    for group, unit, factor in track(cases, "calibrating"):
        results = [_attack(library, scene, label, group, factor) for scene, label in scenes]
        rows.append({"group": group, "unit": unit} | _summary(results))
    provenance = results[0].provenance.model_dump()
    report = {
        "command": "python -m benchmarks.units --views " + str(options.views),
        "machine": platform.platform(),
        "versions": provenance["versions"] | {"scene-attack": version("scene-attack")},
        "backend": provenance["backend"],
        "seed": 0,
        "views": [f"{label}: {scene}" for scene, label in scenes],
        "paper": {"normals": 6.3, "illumination": 1.6, "material": 0.0},
        "rows": rows,
    }
    options.out.write_text(json.dumps(report, indent=1) + "\n", "utf-8")
    for row in rows:
        print(row)


def _spec(mesh: str, label: str, group: str, factor: float) -> JobSpec:
    rate = TORCH.group(group).suggested_step
    assert rate is not None
    attack = {"groups": [group], "learning_rate": {group: rate * factor}}
    return parse({"scene": {"objects": [{"mesh": mesh}]}, "goal": {"leave": label}, "attack": attack})


def _attack(library: Library, mesh: str, label: str, group: str, factor: float) -> Result:
    with tempfile.TemporaryDirectory() as out:
        return execute(_spec(mesh, label, group, factor), Path(out), library)


def _summary(results: list[Result]) -> dict[str, object]:
    fooled = [result for result in results if success(result)]
    return {
        "views": len(results),
        "verified": len(fooled),
        "truncated_mean": statistics.fmean(result.truncated for result in results),
        "truncated_max": max(result.truncated for result in results),
        "p_verified_mean": statistics.fmean(result.perceptibility for result in fooled) if fooled else None,
        "p_held_mean": statistics.fmean(r.perceptibility for r in results if not success(r))
        if len(fooled) < len(results)
        else None,
        "steps_mean": statistics.fmean(result.steps for result in results),
        "seconds_mean": statistics.fmean(result.seconds for result in results),
    }


if __name__ == "__main__":
    main()
