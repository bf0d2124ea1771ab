"""Compares the images that the rasteriser draws in attacks with OpenGL's: no error may exceed the plan's estimate.

Scenes are chosen at random: one to five objects of furniture and primitives, with colours below 1, under one to three
point lights. At several random perturbations within an attack's reach, both sides of the difference of every coordinate
are rendered in one batch, as ZOO does. Each image is compared with the exact renderer's, and gradients of a random
linear objective with those of the exact images: the largest error of a coordinate in a group, relative to the group's
largest gradient.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.report import save
from benchmarks.stale import ROOT
from scene_attack.process import use
from scene_attack.rendering.opengl import context
from scene_attack.rendering.plan import ImageError, image_error
from scene_attack.rendering.pyrender.declaration import PYRENDER
from scene_attack.rendering.pyrender.planner import MEASURED_REACH, both_sides
from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import Scene
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack_service.settings import Settings

MESHES = (
    *("primitive/sphere", "primitive/cube", "primitive/torus", "primitive/cylinder"),
    *("furniture/grand-piano", "furniture/helmet", "furniture/speaker", "furniture/couch", "furniture/folding-chair"),
    *("furniture/barrel", "furniture/clock", "furniture/soccer-ball", "furniture/toaster", "furniture/video-projector"),
)
SEED = 0
STEP = 0.01
"""Half-step of the differences from which gradients are computed, in the groups' units."""


def scenes(count: int) -> Iterator[Scene]:
    """Yields `count` random scenes from a fixed seed. Every second scene has three objects or more."""
    random = np.random.default_rng(SEED)
    for index in range(count):
        objects = int(random.integers(3, 6)) if index % 2 else int(random.integers(1, 3))
        things = [
            {
                "mesh": str(random.choice(MESHES)),
                "color": random.uniform(0.2, 0.9, 3).tolist(),
                "scale": 1.0 if objects == 1 else 0.5,
                "translation": [0.0, 0.0, 0.0] if objects == 1 else random.uniform(-0.4, 0.4, 3).tolist(),
                "rotation": random.uniform(-1.0, 1.0, 3).tolist(),
            }
            for _ in range(objects)
        ]
        lamps = [
            {"energy": float(random.uniform(5, 30)), "position": random.uniform((-2, 0.5, 0.5), 2).tolist()}
            for _ in range(int(random.integers(1, 4)))
        ]
        camera = {"azimuth": float(random.uniform(0, 6)), "size": [112, 112]}
        yield Scene.model_validate({"objects": things, "camera": camera, "lights": {"ambient": 0.4, "points": lamps}})


def compare(scene: Scene, library: Library, images: int) -> dict[str, Any]:
    """Compares at least `images` images of a scene. Returns the number compared, the largest errors (mean and share),
    the plan's estimates of both, and the gradients' error: the largest difference relative to the largest gradient of
    the group.
    """
    renderer = PyrenderRenderer(resolve(scene, library), PYRENDER.group_names)
    stage = next((stage for stage in renderer.plan.stages if stage.name == "rasterise"), None)
    random = torch.Generator().manual_seed(SEED)
    ground = torch.tensor(scene.ground)
    worst, compared, gradients = ImageError(), 0, 0.0
    while compared < images:
        at = {
            group: torch.clamp(
                value + MEASURED_REACH[group] * (2 * torch.rand(value.shape, generator=random, dtype=value.dtype) - 1),
                *renderer.bounds()[group],
            )
            for group, value in renderer.initial().items()
        }
        sides = both_sides(at, renderer.groups, STEP)
        ours, exact = renderer.render(sides), renderer.exact().render(sides)
        for image, true in zip(ours, exact, strict=True):
            worst = worst.or_worse(image_error(image, true, ground)[0])
        compared += len(ours)
        weight = torch.rand(ours.shape[1:], generator=random).flatten() / ours[0].numel()
        gradients = max(gradients, _gradient_error(ours, exact, weight, at))
    return {
        "meshes": [thing.mesh for thing in scene.objects],
        "images": compared,
        "rasterised": renderer.rasterises,
        "mean": worst.mean,
        "share": worst.share,
        "plan_mean": 0.0 if stage is None else stage.error,
        "plan_share": 0.0 if stage is None else stage.share,
        "gradients": gradients,
    }


def _gradient_error(ours: Tensor, exact: Tensor, weight: Tensor, at: dict[str, Tensor]) -> float:
    """The largest error of a group's gradient, relative to the largest exact gradient of the group."""
    sides = [(of[::2] - of[1::2]).double().flatten(1) for of in (ours, exact)]
    computed, true = (side @ weight.double() / (2 * STEP) for side in sides)
    worst, first = 0.0, 0
    for value in at.values():
        own = slice(first, first := first + value.numel())
        worst = max(worst, float((computed[own] - true[own]).abs().max() / true[own].abs().max().clamp_min(1e-12)))
    return worst


def beyond(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of scenes with an image whose error exceeds the plan's estimate."""
    return [row for row in rows if row["mean"] > row["plan_mean"] or row["share"] > row["plan_share"]]


def summary(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The figures of these scenes in short."""
    drawn = [row for row in rows if row["rasterised"]]
    middle, largest = np.quantile([row["gradients"] for row in drawn], (0.5, 1.0))
    return {
        "scenes": len(rows),
        "scenes_rasterised": len(drawn),
        "scenes_of_three_objects_or_more": sum(len(row["meshes"]) >= 3 for row in rows),
        "images": sum(row["images"] for row in rows),
        "images_rasterised": sum(row["images"] for row in drawn),
        "scenes_beyond_estimate": len(beyond(rows)),
        "largest_mean_of_estimate": max(row["mean"] / row["plan_mean"] for row in drawn),
        "largest_share_of_estimate": max(row["share"] / row["plan_share"] for row in drawn),
        "median_gradient_error": float(middle),
        "largest_gradient_error": float(largest),
    }


def main() -> None:
    """Runs the comparison, prints and writes the rows, and exits with status 1 if an error exceeded an estimate."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--images", type=int, default=5000, help="least number of images, over all scenes")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "accuracy" / "rasterised_images.json")
    options = parser.parse_args()
    settings = Settings()
    use(settings)
    library = Library(settings.cache_dir, settings.data_dir)
    rows = []
    for scene in scenes(options.scenes):
        rows.append(row := compare(scene, library, -(-options.images // options.scenes)))
        print(json.dumps(row), flush=True)
    save(options.out, __doc__ or "", context.gl_backend(), SEED, summary=summary(rows), rows=rows)
    sys.exit(bool(beyond(rows)))


if __name__ == "__main__":
    main()
