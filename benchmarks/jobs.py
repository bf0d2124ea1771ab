"""Compares whole FGSM jobs with the network's own passes, and measures their memory. Writes results/jobs.json.

A job of 120 steps runs through scene_attack.runs.execute in a process set up as a worker's. Its learning rate is so
small that the image does not change, so the network holds and all steps run. After each step, the network alone makes a
forward and backward pass on an image of 224², because the speed of a shared machine changes from second to second, and
so that job and pass find the processor's caches in the same state. The time of these passes is subtracted from the
job's. Ratios and seconds are medians of the repeats. Memory is the peak resident set of a fresh process that runs a job
of 448².
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

import torch

from benchmarks.report import RESULTS, save, shortest
from scene_attack.process import ALLOCATOR
from scene_attack.runs.execute import Progress, execute
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import JobSpec, parse
from scene_attack.scenes.library import Library
from scene_attack.targets import registry
from scene_attack.targets.protocol import Target
from scene_attack_service.jobs.processes import warm_up
from scene_attack_service.settings import Settings

ATTACKS: dict[str, dict[str, Any]] = {
    "image": {"renderer": "image"},
    "normals": {"groups": ["normals"]},
    "illumination": {"groups": ["illumination"]},
    "material": {"groups": ["material"]},
    "all": {"groups": ["normals", "illumination", "material"]},
}
STILL = 1e-9
STEPS = 120
MESH = "furniture/grand-piano"


def main() -> None:
    """Runs the comparison; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--attacks", nargs="+", default=list(ATTACKS), choices=list(ATTACKS))
    parser.add_argument("--repeats", type=int, default=5, help="jobs of each kind (default 5)")
    parser.add_argument("--memory-steps", type=int, default=12, help="steps of the jobs of 448² (default 12)")
    parser.add_argument("--out", type=Path, default=RESULTS / "jobs.json")
    parser.add_argument("--one", nargs=3, metavar=("ATTACK", "SIZE", "STEPS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        attack, size, steps = options.one
        print(json.dumps(_measure(attack, int(size), int(steps), options.repeats)))
        return
    rows = []
    for attack in options.attacks:
        row = {"attack": attack} | _in_a_process(attack, 224, STEPS, options.repeats)
        row["peak MiB at 448²"] = _in_a_process(attack, 448, options.memory_steps, 0)["peak MiB"]
        rows.append(row)
        print(", ".join(f"{key} {value:.3g}" if isinstance(value, float) else f"{value}" for key, value in row.items()))
    backend = rows[0]["backend"]
    for row in rows:
        del row["backend"]
    save(options.out, __doc__ or "", backend, 0, mesh=MESH, learning_rate=STILL, steps=STEPS, rows=rows)


def _in_a_process(attack: str, size: int, steps: int, repeats: int) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.jobs", "--one", attack, str(size), str(steps)]
    command += ["--repeats", str(repeats)]
    done = subprocess.run(command, env=os.environ | ALLOCATOR, check=True, capture_output=True, text=True)
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def _measure(attack: str, size: int, steps: int, repeats: int) -> dict[str, Any]:
    """Measures `repeats` jobs beside as many passes of the network; with 0, one job and its memory only."""
    settings = Settings()
    warm_up(settings)
    library = Library(settings.cache_dir, settings.data_dir)
    chosen = ATTACKS[attack]
    groups = chosen.get("groups", ["image"])
    assert isinstance(groups, list)
    held = {"steps": steps, "learning_rate": dict.fromkeys(groups, STILL)}
    scene = {"objects": [{"mesh": MESH}], "camera": {"size": [size, size]}}
    spec = parse({"scene": scene, "attack": chosen | held})
    with tempfile.TemporaryDirectory() as out:
        if repeats == 0:
            execute(spec, Path(out), library)
            return {"peak MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}
        target = registry.load(spec.target.name)
        execute(parse({"scene": scene, "attack": chosen | held | {"steps": 2}}), Path(out), library)  # warms up
        rows: list[dict[str, float]] = []
        for _ in range(repeats):
            job, loop, network = _beside(spec, Path(out), library, target)
            rows.append(
                {
                    "job s": job,
                    "loop s": loop,
                    "network s": network,
                    "job / network": job / network,
                    "loop / network": loop / network,
                }
            )
    middle: dict[str, Any] = {name: median(row[name] for row in rows) for name in rows[0]}
    return middle | {
        "peak MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "backend": prepare(spec, library).backend,
    }


def _beside(spec: JobSpec, out: Path, library: Library, target: Target) -> tuple[float, float, float]:
    """Seconds of a job, of its loop, and of as many passes of a network as it makes steps, each after one of them."""
    image = torch.full((1, 224, 224, 3), 0.5)
    passes: list[float] = []

    @torch.enable_grad()
    def once() -> None:
        leaf = image.clone().requires_grad_()
        torch.autograd.grad(target.logits(leaf)[0, 0], leaf)

    def beside(progress: Progress) -> None:
        if progress.row is not None and progress.step < spec.attack.steps:
            passes.append(shortest(once, 1, 0))

    began = time.perf_counter()
    result = execute(spec, out, library, progress=beside)
    job = time.perf_counter() - began - sum(passes)
    assert (result.verdict.stopped, result.cost.steps, len(passes)) == ("steps", spec.attack.steps, spec.attack.steps)
    return job, result.cost.seconds - sum(passes), sum(passes)


if __name__ == "__main__":
    main()
