"""Compares FGSM with gradients at the rounded image and at the float image. Writes results/rounded_gradient.json.

The network classifies the image rounded to 8 bits for the verdict. Taking the gradient in the same pass, with a
straight-through derivative of the rounding, saves one pass per step. The same attacks run with both gradients.
"""

import argparse
import statistics
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from rich.progress import track

from benchmarks.report import RESULTS, save
from benchmarks.views import right
from client.settings import settings_to_run
from services.analysis.perceptibility import of_images
from services.attacks.fgsm import FgsmMethod
from services.attacks.loop import Budget, run
from services.attacks.problem import AttackProblem, Evaluation, gradients
from services.pipeline.prepare import Prepared, prepare
from services.pipeline.spec import JobSpec, parse
from services.scenes.library import Library

ATTACKS: dict[str, dict[str, object]] = {
    "image": {"renderer": "image"},
    "normals": {"groups": ["normals"]},
    "illumination": {"groups": ["illumination"]},
    "material": {"groups": ["material"]},
    "all": {"groups": ["normals", "illumination", "material"]},
}


class FloatImageFgsm(FgsmMethod):
    """FGSM with the gradient at the image before rounding, which takes a pass of its own."""

    def advance(self, problem: AttackProblem, view: Evaluation, step: int) -> int:
        """One step along the float image's gradients."""
        again = problem.view(self.perturbation, gradient=True)
        found = gradients(problem, again, problem.logits(again.images))
        return super().advance(problem, replace(view, gradients=found), step)


Row = dict[str, Any]
METHODS = {"saved": FgsmMethod, "float": FloatImageFgsm}


def main() -> None:
    """Runs the comparison; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=12, help="views to attack (default 12)")
    parser.add_argument("--attacks", nargs="+", default=list(ATTACKS), choices=list(ATTACKS))
    parser.add_argument("--steps", type=int, default=120, help="most steps of an attack (default 120)")
    parser.add_argument("--out", type=Path, default=RESULTS / "rounded_gradient.json")
    options = parser.parse_args()
    settings = settings_to_run()
    torch.set_num_threads(settings.threads)
    library = Library(settings.cache_dir, settings.data_dir)
    rows: list[Row] = []
    for mesh, label in track(list(right(library, options.views)), "attacking"):
        for attack in options.attacks:
            prepared = prepare(_spec(mesh, label, attack), library)
            runs = {name: _run(prepared, method, options.steps) for name, method in METHODS.items()}
            rows.append({"view": mesh, "attack": attack} | runs)
        summary = [{"attack": a} | _summary([r for r in rows if r["attack"] == a]) for a in options.attacks]
        # after every view, so that nothing is lost when it is stopped
        save(options.out, __doc__ or "", prepared.backend, prepared.spec.seed, summary=summary, rows=rows)
    for line in summary:
        print(line)


def _spec(mesh: str, label: str, attack: str) -> JobSpec:
    return parse({"scene": {"objects": [{"mesh": mesh}]}, "goal": {"leave": label}, "attack": ATTACKS[attack]})


def _run(prepared: Prepared, method: type[FgsmMethod], steps: int) -> Row:
    attack = prepared.spec.attack
    assert attack.truncation is not None
    problem = AttackProblem(
        prepared.renderer, prepared.target, prepared.goal, attack.groups, truncation=attack.truncation / 255
    )
    prepared.verifier.queries = prepared.verifier.renders = 0
    found = run(problem, method(attack, problem), prepared.verifier, Budget(steps))
    p = of_images(prepared.original, prepared.verifier.image(found.stored))
    return {"verified": found.verified, "steps": found.step, "p": p, "advantage": found.trace[-1].advantage}


def _summary(rows: list[Row]) -> Row:
    both = [row for row in rows if all(row[name]["verified"] for name in METHODS)]
    held = [row for row in rows if not any(row[name]["verified"] for name in METHODS)]
    fewer = sum(row["saved"]["steps"] < row["float"]["steps"] for row in rows)
    more = sum(row["saved"]["steps"] > row["float"]["steps"] for row in rows)
    said: Row = {"views": len(rows), "both_verified": len(both), "fewer_steps": fewer, "more_steps": more}
    for name in METHODS:
        said[name] = {
            "verified": sum(bool(row[name]["verified"]) for row in rows),
            "steps_where_both": statistics.fmean(row[name]["steps"] for row in both) if both else None,
            "p_where_both": statistics.fmean(row[name]["p"] for row in both) if both else None,
            "last_advantage_where_none": statistics.fmean(row[name]["advantage"] for row in held) if held else None,
        }
    return said


if __name__ == "__main__":
    main()
