"""Tests whether the torch renderer's estimates hold during attacks. Writes results/attack_bounds.json.

60 random odd scenes, and 16 chosen to break the estimates, are attacked for 120 steps; every image is compared with the
exact renderer's. A run that was stopped is resumed by the same command; remove its file if the code has changed.
"""

import argparse
import json
import random
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from time import perf_counter
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field
from rich.progress import track

from benchmarks.report import RESULTS, head, save
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem, Evaluation, differentiate, evaluate, quantize
from scene_attack.rendering.opengl.gbuffer import rasterise
from scene_attack.rendering.plan import GradientError
from scene_attack.rendering.torch.declaration import TORCH
from scene_attack.rendering.torch.renderer import TorchRenderer
from scene_attack.runs.environment import options_to_run
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack.targets import registry
from scene_attack_accuracy.provenance import backend

FLAT = ("primitive/plane", "primitive/cube", "furniture/table4")
"""Meshes with few distinct normals, which an attack moves far from the normals at which a table was measured."""
ROUND = (
    "primitive/sphere",
    "primitive/cylinder",
    "primitive/cone",
    "primitive/torus",
    "primitive/capsule",
    "furniture/soccer-ball",
    "furniture/grand-piano",
    "furniture/couch",
)
MATERIALS = ("matte", "plastic", "glossy-paint", "brushed-metal")
MAPS = ("city", "courtyard", "forest", "interior", "night", "studio", "sunrise", "sunset")
GROUPS = tuple(c for n in (1, 2, 3) for c in combinations(TORCH.default_groups, n))
STEPS = 120
TARGET = "efficientnet-lite0"


@dataclass(frozen=True)
class AttackedScene:
    """A scene, the groups attacked in it and the tolerance of its plan."""

    name: str
    scene: Scene
    groups: tuple[str, ...]
    tolerance: float


class AttackErrors(BaseModel):
    """The errors of all images of one attack. An error is a difference of displayed values in [0,1]."""

    model_config = ConfigDict(extra="forbid")

    name: str
    scene: dict[str, Any]
    groups: tuple[str, ...]
    tolerance: float
    table: bool = Field(description="whether the plan uses a table over normals")
    estimate: float = Field(description="the plan's estimated error")
    images: int
    worst: float = Field(description="largest error of any image, against the exact renderer's image")
    worst_step: int
    beyond: int = Field(description="images with a larger error than the estimate")
    failed_checks: int = Field(description="images summed pixel by pixel because their sampled check failed")
    gradients: tuple[GradientError, ...]
    seconds: float


def random_scenes(count: int, seed: int = 0, sizes: tuple[int, ...] = (64, 80, 96)) -> Iterator[AttackedScene]:
    """Yields `count` random scenes of flat and round meshes, which take turns over all combinations of groups.

    `sizes` are the heights and widths of images to choose from, in pixels.
    """
    draw = random.Random(seed)
    for k in range(count):
        size = draw.choice(sizes)
        viewer = "perspective" if draw.random() < 0.1 else "distant"
        texels = draw.choice(((4, 8), (8, 16), (16, 32), (16, 32)))
        mesh = draw.choice(FLAT if draw.random() < 0.5 else ROUND)
        yield _scene(
            f"random {k}", mesh, draw, size, texels, viewer, GROUPS[k % len(GROUPS)], draw.choice((1e-3, 1e-2))
        )


def adversarial_scenes(seed: int = 1) -> Iterator[AttackedScene]:
    """Yields 16 scenes chosen to break a table's estimate: glossy objects with few normals, which are attacked."""
    draw = random.Random(seed)
    moving = [groups for groups in GROUPS if "normals" in groups]
    choices = [
        *((mesh, material, 64) for mesh in FLAT for material in ("glossy-paint", "plastic", "brushed-metal")),
        *(("primitive/cone", material, 64) for material in ("glossy-paint", "brushed-metal")),
        *(("primitive/cylinder", material, 96) for material in ("glossy-paint", "plastic")),
        ("primitive/plane", "glossy-paint", 128),
        ("primitive/cube", "glossy-paint", 128),
        ("furniture/table4", "glossy-paint", 128),
    ]
    for k, (mesh, material, size) in enumerate(choices):
        texels = (4, 8) if mesh == "furniture/table4" else (16, 32)
        groups, tolerance = moving[k % len(moving)], (1e-2, 1e-3)[k % 2]
        yield _scene(f"adversarial {k}", mesh, draw, size, texels, "distant", groups, tolerance, material)


def _scene(
    name: str,
    mesh: str,
    draw: random.Random,
    size: int,
    texels: tuple[int, int],
    viewer: str,
    groups: tuple[str, ...],
    tolerance: float,
    material: str | None = None,
) -> AttackedScene:
    described = {
        "camera": {
            "size": (size, size),
            "azimuth": draw.uniform(-3, 3),
            "elevation": draw.uniform(-0.2, 1.2),
            "viewer": viewer,
        },
        "objects": [{"mesh": mesh, "material": material or draw.choice(MATERIALS)}],
        "lights": {"environment": {"map": draw.choice(MAPS), "size": texels, "rotation": draw.uniform(0, 6)}},
    }
    return AttackedScene(name, Scene.model_validate(described), groups, tolerance)


def attack_errors(case: AttackedScene, library: Library, steps: int = STEPS) -> AttackErrors:
    """Attacks a scene by FGSM and compares the image of every step with the exact renderer's.

    The attack takes all `steps`, also after the network is fooled, and does not truncate. Raises as `resolve` does.
    """
    began = perf_counter()
    scene = resolve(case.scene, library)
    renderer = TorchRenderer(scene, rasterise(scene), case.groups, case.tolerance)
    errors = list(_errors(renderer, case.groups, steps))
    worst = max(range(len(errors)), key=errors.__getitem__)
    return AttackErrors(
        name=case.name,
        scene=case.scene.model_dump(mode="json", exclude_defaults=True),
        groups=case.groups,
        tolerance=case.tolerance,
        table=any(stage.name.startswith("sampled check") for stage in renderer.plan.stages),
        estimate=renderer.plan.error,
        images=len(errors),
        worst=errors[worst],
        worst_step=worst,
        beyond=sum(error > renderer.plan.error for error in errors),
        failed_checks=renderer.failed_checks,
        gradients=renderer.plan.gradients,
        seconds=perf_counter() - began,
    )


def _errors(renderer: TorchRenderer, groups: tuple[str, ...], steps: int) -> Iterator[float]:
    """Yields the error of each image of an attack by FGSM with the paper's settings."""
    target = registry.load(TARGET)
    settings = FGSM(groups=groups, truncation=None)
    start = renderer.exact().render({group: renderer.initial()[group][None].double() for group in groups})
    first = int(target.logits(quantize(start.float())[1])[0].argmax())
    problem = AttackProblem.of(
        renderer, target, ResolvedGoal(leave=(first,), reach=None), Limits.of(renderer, settings.groups)
    )
    state = settings.init(problem)
    for step in range(steps + 1):
        evaluation = evaluate(problem, state["delta"], step, gradient=True)
        yield _error(renderer, problem, evaluation)
        if step < steps:
            state = settings.step(problem, state, differentiate(problem, evaluation))


@torch.no_grad()
def _error(renderer: TorchRenderer, problem: AttackProblem, evaluation: Evaluation) -> float:
    values = problem.layout.unflatten((problem.initial + evaluation.delta)[None])
    exact = renderer.exact().render({group: value.double() for group, value in values.items()})
    return float((evaluation.image.double() - exact).abs().max())


def main() -> None:
    """Runs the attacks; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=60, help="random scenes (default 60)")
    parser.add_argument("--seed", type=int, default=0, help="of the random scenes (default 0)")
    parser.add_argument("--threads", type=int, default=2, help="of torch (default 2)")
    parser.add_argument("--out", type=Path, default=RESULTS / "attack_bounds.json")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    cases = [*adversarial_scenes(), *random_scenes(options.random, options.seed)]
    made_by = (__doc__ or "", backend(), options.seed)
    measured = _earlier(options.out, head(*made_by))
    settings = options_to_run()
    library = Library(settings.cache_dir, settings.data_dir)
    for case in track([case for case in cases if case.name not in measured], "attacking"):
        row = measured[case.name] = attack_errors(case, library)
        rows = list(measured.values())
        save(
            options.out,
            *made_by,
            summary=_summary(rows) | {"scenes_planned": len(cases)},
            rows=[row.model_dump(mode="json") for row in rows],
        )
        print(
            f"{row.name}: {case.scene.objects[0].mesh}, {' '.join(row.groups)}, tolerance {row.tolerance:g}: "
            f"worst {row.worst:.1e} of {row.estimate:.1e}, {row.failed_checks} checks failed, {row.beyond} beyond"
        )


def _earlier(path: Path, made_by: dict[str, object]) -> dict[str, AttackErrors]:
    """The rows of an earlier run of the same command by the same versions; empty if there is none."""
    if not path.exists():
        return {}
    report = json.loads(path.read_text("utf-8"))
    if {name: report.get(name) for name in made_by} != made_by:
        return {}
    return {row["name"]: AttackErrors.model_validate(row) for row in report["rows"]}


def _summary(rows: list[AttackErrors]) -> dict[str, float]:
    return {
        "scenes": len(rows),
        "scenes_with_tables": sum(row.table for row in rows),
        "images": sum(row.images for row in rows),
        "images_beyond_estimate": sum(row.beyond for row in rows),
        "images_of_failed_checks": sum(row.failed_checks for row in rows),
        "largest_share_of_estimate": max(row.worst / row.estimate for row in rows),
    }


if __name__ == "__main__":
    main()
