"""Attacks light and material in several units, and compares successes, p and truncated pixels with the paper's.

The paper gives learning rates, but not the units of L and m. An attack in another unit is an attack with the learning
rate scaled, so one build measures all. Views are those that a network gets right, the most confident of each class
first, as in the paper. Images are 448² unless asked otherwise; attacks are FGSM with its defaults, at most 120 steps.

The run is a campaign in a folder: interrupted, the same command goes on with what is left. The result is written again
after every attack, so that a run that is stopped leaves what it has found.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from benchmarks.report import RESULTS, head
from benchmarks.views import VIEWS
from client.campaign_live import CampaignLine
from services import atomic_write
from services.analysis.campaign_table import Case, table
from services.pipeline.campaign_expand import views
from services.pipeline.campaign_run import CampaignProgress, run_campaign
from services.pipeline.campaign_spec import CampaignSpec, parse
from services.rendering.opengl import context
from services.rendering.opengl.gbuffer import rasterise
from services.rendering.torch_renderer.declaration import TORCH
from services.rendering.torch_renderer.units import ILLUMINATION_MEAN, MATERIAL_UNIT
from services.scenes.description import Scene
from services.scenes.library import Library
from services.scenes.resolve import resolve
from services.settings import settings

ROOT = Path(__file__).parents[1]
STUDY = ROOT / "examples" / "paper-differentiable.json"
"""The campaign whose meshes are attacked here too. The shipped networks were trained on none of them."""
LITE0 = "efficientnet-lite0"
TARGETS = ("alexnet-furniture", "resnet34-furniture", LITE0)
UNITS: dict[str, tuple[float, ...]] = {
    "illumination": (10.0, 3.0, 1.0),
    "illumination_rgb": (10.0, 3.0),
    "material": (30.0, 10.0, 3.0),
}
"""Group to units: the map's mean intensity, and coordinates per natural logarithm of κ or γ."""
OWN_UNIT = {"illumination": ILLUMINATION_MEAN, "illumination_rgb": ILLUMINATION_MEAN, "material": MATERIAL_UNIT}
"""The units that the renderer has."""
SEVERAL = {
    "combined": ("normals", "illumination", "material"),
    "combined, light in three channels": ("normals", "illumination_rgb", "material"),
}
"""Column to groups that are attacked together, in the renderer's units."""


def main() -> None:
    """Runs the calibration; see --help."""
    options = _options()
    torch.set_num_threads(settings().threads)
    library = Library(settings().cache_dir, settings().data_dir)
    attacks = [one for one in columns(options.steps) if one["name"].startswith(tuple(options.only or ("",)))]
    scenes = {"material": options.material, "camera": {"size": [options.size] * 2}, "views": {"random": 4, "seed": 0}}
    asked = campaign({name: meshes(name)[: options.meshes] for name in options.targets}, attacks, scenes, options.views)
    backend = f"{context.gl_backend()}; torch {torch.__version__} {torch.get_num_threads()} threads"
    about = head(str(__doc__).split("\n\n")[0], backend, 0) | {"size": options.size, "material": options.material}

    def save(cases: Sequence[Case], **more: object) -> None:
        report = about | content(cases) | more
        atomic_write.write(options.out, (json.dumps(report, indent=1) + "\n").encode())

    def progress(now: CampaignProgress) -> None:
        line.update(now)
        if now.cases:
            save(now.cases, planned=now.total)

    with CampaignLine(asked.name) as line:
        found = run_campaign(asked, options.folder, library, progress=progress)
    chosen = [view for view in found.views if view.chosen]
    every = views(asked)
    report = json.loads(options.out.read_text("utf-8"))
    report["coverage"] = coverages([every[view.number].probe.scene for view in chosen], library)
    report["views"] = [view.model_dump(mode="json", exclude={"chosen", "why"}) for view in chosen]
    atomic_write.write(options.out, (json.dumps(report, indent=1) + "\n").encode())
    print(f"written to {options.out}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=30, help="views of each network (default 30)")
    parser.add_argument("--size", type=int, default=448, help="height and width in pixels (default 448)")
    parser.add_argument("--material", default="plastic", help="DSBRDF preset (default plastic, the study's)")
    parser.add_argument("--steps", type=int, default=120, help="largest number of steps (default 120)")
    parser.add_argument("--targets", nargs="+", default=list(TARGETS), choices=TARGETS, help="networks (default all)")
    parser.add_argument("--meshes", type=int, help="only the first so many meshes of each network, for a trial")
    parser.add_argument("--only", nargs="+", help="only these columns, by the beginning of their names, for a trial")
    parser.add_argument(
        "--folder", type=Path, default=Path("out") / "units", help="of the campaign (default out/units)"
    )
    parser.add_argument("--out", type=Path, default=RESULTS / "units_448.json")
    return parser.parse_args()


def columns(steps: int) -> list[dict[str, Any]]:
    """The attacks: the image, normals, each unit of each group, and several groups together."""
    image = {"renderer": "image", "method": "fgsm", "steps": steps}
    plain = {"renderer": "torch", "method": "fgsm", "steps": steps}
    found = [{"name": "image", "attack": image}, {"name": "normals", "attack": plain | {"groups": ["normals"]}}]
    for group, units in UNITS.items():
        step = TORCH.group(group).suggested_step
        assert step is not None
        for unit in units:
            scaled = plain | {"groups": [group], "learning_rate": {group: step * OWN_UNIT[group] / unit}}
            found.append({"name": f"{group}, unit {unit:g}", "attack": scaled})
    return [*found, *({"name": name, "attack": plain | {"groups": list(groups)}} for name, groups in SEVERAL.items())]


def meshes(target: str) -> list[str]:
    """The meshes that are shown to a network."""
    if target == LITE0:
        return [mesh for mesh, _ in json.loads(VIEWS.read_text("utf-8"))["views"]]
    found: list[str] = json.loads(STUDY.read_text("utf-8"))["grids"][0]["scenes"]["meshes"]
    return found


def campaign(
    shown: dict[str, list[str]], attacks: list[dict[str, Any]], scenes: dict[str, Any], count: int
) -> CampaignSpec:
    """The campaign of all attacks on `count` views of each network, chosen among those of the meshes it is shown."""
    selection = {"per_mesh": 2, "per_class": 6, "most": count}
    grids = [
        {"scenes": scenes | {"meshes": own}, "targets": [target], "attacks": attacks, "selection": selection}
        for target, own in shown.items()
    ]
    return parse({"name": "units", "grids": grids})


def content(cases: Sequence[Case]) -> dict[str, Any]:
    """The figures of the attacks that have ended: a row for each network and column, and the time that all took."""
    found = table("units", [(case.target, case.attack) for case in cases], cases)
    rows = [cell.model_dump(mode="json", exclude={"by_queries", "by_seconds"}) for cell in found.cells]
    for row in rows:
        own = [case for case in cases if (case.target, case.attack) == (row["target"], row["attack"])]
        row["run_seconds"] = sum(case.run_seconds or 0.0 for case in own) / len(own)
    return {"ended": len(cases), "run_seconds": sum(case.run_seconds or 0.0 for case in cases), "rows": rows}


def coverages(scenes: Sequence[Scene], library: Library) -> list[float]:
    """The share of each view's pixels that its object covers."""
    return [float(rasterise(resolve(scene, library)).coverage.mean()) for scene in scenes]


if __name__ == "__main__":
    main()
