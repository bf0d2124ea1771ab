"""Compares one step of ZOO over the 14 parameters with the network's pass, and our frames with pyrender's. Writes
results/zoo_step.json.

For each view it measures in turn: the network's pass over 28 images; our step (both sides of 14 differences rendered
and classified, and the move); the same step as a loop that renders and classifies 28 images one by one (as 3DB does);
the 28 images alone, with shared stages and one by one; a frame of ours, and a frame of pyrender's own renderer (8 bits,
its own shading). It runs with the allocator settings of a job's
process. Seconds are the shortest of the rounds, and ratios are medians over the rounds, because the speed of a shared
machine changes from second to second.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import torch

from benchmarks.report import RESULTS, save
from benchmarks.views import right
from scene_attack.attacks.problem import AttackProblem, evaluate
from scene_attack.process import ALLOCATOR
from scene_attack.rendering.opengl import context
from scene_attack.rendering.pyrender.planner import both_sides
from scene_attack.runs.environment import options_to_run
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene

SEED = 0
LIMIT = 1.5
"""Largest ratio of a step's time to the network's own time that the project accepts."""


def main() -> None:
    """Runs the measurements and writes the result; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=6, help="views to measure (default 6)")
    parser.add_argument("--repeats", type=int, default=8, help="rounds (default 8)")
    parser.add_argument("--out", type=Path, default=RESULTS / "zoo_step.json")
    options = parser.parse_args()
    if any(os.environ.get(name) != value for name, value in ALLOCATOR.items()):
        os.execve(sys.executable, [sys.executable, "-m", "benchmarks.zoo_step", *sys.argv[1:]], os.environ | ALLOCATOR)
    settings = options_to_run()
    torch.set_num_threads(settings.threads)
    library = Library(settings.cache_dir, settings.data_dir)
    rows = [_measure(library, mesh, label, options.repeats) for mesh, label in right(library, options.views)]
    backend = f"{context.gl_backend()}; torch {torch.__version__} {torch.get_num_threads()} threads"
    save(options.out, str(__doc__).split("\n\n")[0], backend, SEED, limit=LIMIT, allocator=ALLOCATOR, views=rows)


def _measure(library: Library, mesh: str, label: str, repeats: int) -> dict[str, object]:
    attack = {"renderer": "pyrender", "method": "zoo", "coordinates": 14, "delta": 0.01}
    spec = parse({"scene": {"objects": [{"mesh": mesh}]}, "goal": {"leave": label}, "attack": attack, "seed": SEED})
    ready = prepare(spec, library)
    renderer = ready.renderer
    problem = AttackProblem.of(
        renderer, ready.target, ready.settled.goal, ready.limits, seed=SEED, distance_weight=0.001
    )
    state = spec.attack.init(problem)
    evaluation = evaluate(problem, state["delta"], 0)
    sides = both_sides(renderer.initial(), spec.attack.groups)
    start = {group: value[None] for group, value in renderer.initial().items()}
    images = renderer.render(sides)
    exact = renderer.exact()

    def one_by_one() -> None:
        for row in range(len(images)):
            ready.target.logits(exact.render({group: value[row : row + 1] for group, value in sides.items()}))

    with torch.no_grad():
        times = _in_turn(
            {
                "network_28": lambda: ready.target.logits(images),
                "zoo_step": lambda: spec.attack.step(problem, state, evaluation),
                "loop_of_28": one_by_one,
                "images_28_shared": lambda: renderer.render(sides),
                "images_28_alone": lambda: exact.render(sides),
                "frame": lambda: renderer.render(start),
                "stock_pyrender_frame": _stock(ready.scene),
            },
            repeats,
        )
    ratios = {
        "zoo_step / network_28": ("zoo_step", "network_28"),
        "loop_of_28 / zoo_step": ("loop_of_28", "zoo_step"),
        "images_28_alone / images_28_shared": ("images_28_alone", "images_28_shared"),
        "frame / stock_pyrender_frame": ("frame", "stock_pyrender_frame"),
    }
    return {
        "mesh": mesh,
        "faces": sum(m.triangles for m in ready.scene.meshes),
        "seconds": {name: min(runs) for name, runs in times.items()},
        "ratios": {
            name: median(one / other for one, other in zip(times[a], times[b], strict=True))
            for name, (a, b) in ratios.items()
        },
    }


def _in_turn(works: dict[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    """Seconds of each work's runs; they take turns, after a round that warms up."""
    took: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds + 1):
        for name, work in works.items():
            began = time.perf_counter()
            work()
            took[name].append(time.perf_counter() - began)
    return {name: runs[1:] for name, runs in took.items()}


def _stock(scene: ResolvedScene) -> Callable[[], object]:
    """A frame of pyrender's own renderer, in the same context: the same faces, light and samples."""
    import pyrender

    stock = pyrender.Scene(ambient_light=[0.4] * 3)
    for mesh, model in zip(scene.meshes, scene.models, strict=True):
        parts = [
            pyrender.Primitive(
                positions=part.vertices,
                normals=part.normals,
                indices=part.faces,
                material=pyrender.MetallicRoughnessMaterial(baseColorFactor=part.color),
            )
            for part in mesh.parts
        ]
        stock.add(pyrender.Mesh(parts), pose=model)
    for point in scene.description.lights.points:
        pose = np.eye(4)
        pose[:3, 3] = point.position
        stock.add(pyrender.PointLight(intensity=point.energy), pose=pose)
    stock.add(pyrender.PerspectiveCamera(scene.description.camera.field_of_view), pose=scene.view)
    height, width = scene.description.camera.size
    context.current()
    renderer = pyrender.Renderer(width, height)
    return lambda: renderer.render(stock, pyrender.RenderFlags.OFFSCREEN)


if __name__ == "__main__":
    main()
