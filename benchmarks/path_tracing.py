"""Measures the path tracers: error against run time, a frame's time by threads, a step of ZOO, and the use of a common
seed. Writes results/path_tracing.json.

Errors are of displayed values over covered pixels against an image of 4,096 samples under another seed. Seconds are the
shortest of the rounds. The gradient of a step is that of the objective of a network's scores, by differences at all 14
coordinates and the half-steps that ZOO measures: with one seed for all images, as attacks have it, and with a seed for
each image. Two estimates under other seeds agree if their cosine is near 1.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import cosine_similarity

from benchmarks.report import RESULTS, save, shortest
from scene_attack.attacks.differences import estimate
from scene_attack.attacks.problem import AttackProblem, evaluate
from scene_attack.process import versions
from scene_attack.rendering.factory import build
from scene_attack.rendering.pyrender.path_traced import PathTracing
from scene_attack.rendering.pyrender.path_tracer import PathTracer
from scene_attack.runs.environment import options_to_run
from scene_attack.runs.prepare import Prepared, prepare
from scene_attack.runs.spec import parse
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import ResolvedScene, resolve

SEED = 0
MESH = "furniture/grand-piano"
SCENE = {"camera": {"size": [112, 112]}, "objects": [{"mesh": MESH}], "shadows": {}}
SAMPLES = (1, 4, 16, 64, 256)
REFERENCE = 4096
THREADS = (1, 2)
TRACERS = ("blender", "mitsuba")
STEP_SAMPLES = (16,)
"""Samples of the images of which a step is measured."""


def main() -> None:
    """Runs the measurements and writes the result; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=3, help="rounds (default 3)")
    parser.add_argument("--out", type=Path, default=RESULTS / "path_tracing.json")
    options = parser.parse_args()
    settings = options_to_run()
    torch.set_num_threads(settings.threads)
    library = Library(settings.cache_dir, settings.data_dir)
    rows = [_measured(library, name, options.repeats) for name in TRACERS]
    steps = [_step(library, samples, options.repeats) for samples in STEP_SAMPLES]
    backend = ", ".join(f"{name} {found}" for name, found in versions("bpy", "mitsuba").items())
    save(
        options.out,
        str(__doc__).split("\n\n")[0],
        backend,
        SEED,
        scene=SCENE,
        threads=settings.threads,
        reference_samples=REFERENCE,
        tracers=rows,
        zoo=steps,
    )


def _tracer(scene: ResolvedScene, name: str, **settings: int) -> PathTracer:
    renderer = build(scene, name, settings=PathTracing(**settings))
    assert isinstance(renderer, PathTracer)
    return renderer


def _frames(renderer: PathTracer) -> Callable[[], Tensor]:
    """Draws an image that is another each time, as those of an attack are: the scene's own is kept."""
    color = renderer.initial()["color"][None].clone()

    def draw() -> Tensor:
        color.mul_(0.999)
        return renderer.render({"color": color})

    return draw


def _measured(library: Library, name: str, repeats: int) -> dict[str, object]:
    spec = parse({"scene": SCENE})
    scene = resolve(spec.scene, library)
    reference = _tracer(scene, name, samples=REFERENCE, seed=1000).render({})[0]
    covered = (reference != torch.tensor(scene.ground, dtype=torch.float32)).any(dim=-1)
    rows = []
    for samples in SAMPLES:
        renderer = _tracer(scene, name, samples=samples, seed=SEED)
        off = (renderer.render({})[0] - reference)[covered].double()
        rows.append(
            {
                "samples": samples,
                "seconds": shortest(_frames(renderer), repeats, warm_up=1),
                "mean": float(off.abs().mean()),
                "rms": float(off.square().mean().sqrt()),
            }
        )
    threads = torch.get_num_threads()
    seconds = {}
    for count in THREADS:
        torch.set_num_threads(count)
        frames = _frames(_tracer(resolve(spec.scene, library), name, samples=16))
        seconds[str(count)] = shortest(frames, repeats, warm_up=1)
    torch.set_num_threads(threads)
    return {"renderer": name, "error": rows, "seconds_of_16_samples_by_threads": seconds}


def _step(library: Library, samples: int, repeats: int) -> dict[str, object]:
    attack = {"renderer": "blender", "method": "zoo", "renderer_settings": {"samples": samples, "verify_samples": 16}}
    spec = parse({"scene": SCENE, "goal": {"leave": "grand piano"}, "attack": attack, "seed": SEED})
    ready = prepare(spec, library)
    problem = _problem(ready, ready.renderer)
    state = spec.attack.init(problem)
    evaluation = evaluate(problem, state["delta"], 0)
    images = problem.original.expand(28, -1, -1, -1).contiguous()

    def gradient(renderer: object) -> Tensor:
        half_steps, other = state["half_steps"], replace(problem, renderer=renderer)
        return estimate(other, state["delta"], torch.arange(len(half_steps)), half_steps, 0.0).gradients

    own = ready.renderer
    assert isinstance(own, PathTracer)
    common = [gradient(own.reseeded(1000 * k)) for k in (1, 2)]
    apart = [gradient(_OfManySeeds(own.reseeded(1000 * k))) for k in (3, 4)]
    with torch.no_grad():
        return {
            "renderer": "blender",
            "samples": samples,
            "half_steps": {g: float(state["half_steps"][problem.layout.starts[g]]) for g in problem.layout.groups},
            "noise": float(state["noise"]),
            "seconds": {
                "network_28": shortest(lambda: ready.target.logits(images), repeats, warm_up=1),
                "zoo_step": shortest(lambda: spec.attack.step(problem, state, evaluation), repeats, warm_up=0),
            },
            "cosine_of_gradients": {
                "one seed for both sides": float(cosine_similarity(*common, dim=0)),
                "a seed for each image": float(cosine_similarity(*apart, dim=0)),
            },
        }


def _problem(ready: Prepared, renderer: object) -> AttackProblem:
    return AttackProblem.of(
        renderer,  # type: ignore[arg-type]
        ready.target,
        ready.settled.goal,
        ready.limits,
        seed=SEED,
        distance_weight=ready.spec.attack.distance_weight,
    )


class _OfManySeeds:
    """A path tracer whose images each have a seed of their own."""

    def __init__(self, renderer: PathTracer) -> None:
        self._renderer = renderer
        self._drawn = 0

    def __getattr__(self, name: str) -> object:
        return getattr(self._renderer, name)

    def render(self, parameters: dict[str, Tensor]) -> Tensor:
        """As the renderer does, under the next seeds."""
        images = []
        for row in range(len(next(iter(parameters.values())))):
            self._drawn += 1
            seeded = self._renderer.reseeded(self._drawn)
            images.append(seeded.render({group: value[row : row + 1] for group, value in parameters.items()})[0])
        return torch.stack(images)


if __name__ == "__main__":
    main()
