"""Compares attacks on the paper's 14 parameters of pyrender: with gradients by differences of the image, and with
differences of the objective. Writes results/image_differences.json.

Each view is attacked by FGSM with its defaults, whose gradient is the network's with respect to the image times
differences of the image; by ZOO with its defaults; and by ZOO with the settings of the paper. All start from the same
images and none has a limit U, so that p, which is stated, is what it comes to. A success is a verified adversary.
`objective` is what the method minimises, at the start, at its lowest, and after the last step. `queries` compares the
network's queries of FGSM and ZOO on the views that FGSM fools.

`steps` is the perceptibility of one signed step of each group: with random signs, the median over the views.
"""

import argparse
from pathlib import Path
from statistics import median

import torch
from rich.console import Console
from rich.table import Table

from benchmarks.report import RESULTS, save
from benchmarks.views import right
from client.settings import settings_to_run
from services.attacks.attack import ATTACKS
from services.attacks.problem import AttackProblem
from services.attacks.run import AttackState, Budget, run
from services.attacks.seeds import generator
from services.pipeline.prepare import Prepared, prepare
from services.pipeline.spec import parse
from services.rendering.opengl import context
from services.rendering.pyrender_renderer.declaration import PYRENDER
from services.scenes.library import Library

SEED = 0
TIMES = 10
"""Factor on the queries of FGSM within which ZOO's successes are counted."""
SIGNS = 8
"""Random steps of each group whose perceptibility is measured."""
WAYS = {
    "fgsm": {"method": "fgsm"},
    "zoo": {"method": "zoo"},
    "zoo, paper": {"method": "zoo", "preset": "paper-classification"},
}
"""What is attacked with, by its name in the result."""


def main() -> None:
    """Runs the attacks and writes the result; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=12, help="views to attack (default 12)")
    parser.add_argument("--first", type=int, default=0, help="views of the list to pass over (default 0)")
    parser.add_argument("--fgsm-steps", type=int, default=120, help="largest number of steps of fgsm (default 120)")
    parser.add_argument("--zoo-steps", type=int, default=100, help="largest number of steps of zoo (default 100)")
    parser.add_argument("--out", type=Path, default=RESULTS / "image_differences.json")
    options = parser.parse_args()
    settings = settings_to_run()
    torch.set_num_threads(settings.threads)
    library = Library(settings.cache_dir, settings.data_dir)
    views = list(right(library, options.first + options.views))[options.first :]
    steps = {"fgsm": options.fgsm_steps, "zoo": options.zoo_steps, "zoo, paper": options.zoo_steps}
    moved = {group: median(_p_of_step(library, *view, group) for view in views) for group in PYRENDER.group_names}
    backend = f"{context.gl_backend()}; torch {torch.__version__} {torch.get_num_threads()} threads"
    rows: list[dict[str, object]] = []
    for view in views:  # written after every view: a run that is stopped leaves what it has found
        rows += [_attack(library, *view, way, steps[way]) for way in WAYS]
        summary = {way: _summary([row for row in rows if row["way"] == way]) for way in WAYS}
        report = {"summary": summary, "queries": compared(rows), "steps": moved, "rows": rows}
        save(options.out, str(__doc__).split("\n\n")[0], backend, SEED, **report)
    _show(rows)


def _prepared(library: Library, mesh: str, label: str, attack: dict[str, object]) -> Prepared:
    given = {"renderer": PYRENDER.name} | attack
    scene = {"objects": [{"mesh": mesh}]}
    return prepare(parse({"scene": scene, "goal": {"leave": label}, "attack": given, "seed": SEED}), library)


def _attack(library: Library, mesh: str, label: str, way: str, steps: int) -> dict[str, object]:
    ready = _prepared(library, mesh, label, WAYS[way] | {"steps": steps})
    settings = ready.spec.attack
    problem = AttackProblem(
        ready.renderer, ready.target, ready.goal, settings.groups, seed=SEED, weight=settings.distance_weight
    )
    method = ATTACKS[settings.method].method(settings, problem)
    found: AttackState = run(problem, method, ready.verifier, Budget(settings.steps))
    objectives = [row.objective for row in found.trace if row.objective is not None]
    last = found.trace[-1]
    print(mesh, way, found.stopped, last.queries, flush=True)
    return {
        "mesh": mesh,
        "way": way,
        "verified": found.verified,
        "steps": found.step,
        "queries": last.queries,
        "renders": last.renders,
        "seconds": found.seconds,
        "p": last.perceptibility,
        "advantage": [found.trace[0].advantage, last.advantage],
        "objective": {
            "start": objectives[0],
            "lowest": min(objectives),
            "step of lowest": objectives.index(min(objectives)),
            "end": objectives[-1],
        },
        "measured": found.settings,
    }


def _summary(rows: list[dict[str, object]]) -> dict[str, object]:
    good = [row for row in rows if row["verified"]]
    return {
        "views": len(rows),
        "verified": len(good),
        "queries of a success, median": median(row["queries"] for row in good) if good else None,  # type: ignore[type-var]
        "p of a success, median": median(row["p"] for row in good) if good else None,  # type: ignore[type-var]
        "objective lowest after step 0": sum(row["objective"]["step of lowest"] > 0 for row in rows),  # type: ignore[index]
    }


def compared(rows: list[dict[str, object]]) -> dict[str, object]:
    """ZOO on the views that FGSM fools in q queries: how many it fools, how many of them within `TIMES` q; and for all
    these views the queries of FGSM, and those of ZOO whether it fools the network or not, so that their ratio is a
    lower bound.
    """
    by = {(row["mesh"], row["way"]): row for row in rows}
    fooled = [mesh for mesh, way in by if way == "fgsm" and by[mesh, way]["verified"]]
    queries = {way: [int(str(by[mesh, way]["queries"])) for mesh in fooled] for way in ("fgsm", "zoo")}
    zoo = [bool(by[mesh, "zoo"]["verified"]) for mesh in fooled]
    within = [ours <= TIMES * q for ours, q in zip(queries["zoo"], queries["fgsm"], strict=True)]
    return {
        "fooled by fgsm": len(fooled),
        "of these by zoo": sum(zoo),
        f"within {TIMES} times the queries": sum(a and b for a, b in zip(zoo, within, strict=True)),
        "queries of fgsm": sum(queries["fgsm"]),
        "queries of zoo": sum(queries["zoo"]),
        "times as many, at least": sum(queries["zoo"]) / sum(queries["fgsm"]) if fooled else None,
    }


def _p_of_step(library: Library, mesh: str, label: str, group: str) -> float:
    """Perceptibility of a suggested step of all coordinates of a group at random signs, within bounds; the mean."""
    ready = _prepared(library, mesh, label, {"groups": [group]})
    problem = AttackProblem(ready.renderer, ready.target, ready.goal, (group,), seed=SEED)
    step = PYRENDER.group(group).suggested_step
    assert step is not None
    signs = 2 * torch.randint(0, 2, (SIGNS, problem.layout.total), generator=generator(SEED, "signs")) - 1
    moved = problem.clamp(problem.layout.unflatten(step * signs.double()))
    with torch.no_grad():
        images = problem.render({group: problem.initial[group] + moved[group]})
    return float((images - problem.original).square().sum(-1).mean((1, 2)).sqrt().mean())


def _show(rows: list[dict[str, object]]) -> None:
    table = Table(title="Attacks on the 14 parameters")
    for name in ("mesh", "way", "verified", "steps", "queries", "p", "objective"):
        table.add_column(name)
    for row in rows:
        found = row["objective"]
        path = f"{found['start']:.2f} → {found['lowest']:.2f} at step {found['step of lowest']}"  # type: ignore[index]
        table.add_row(
            *(str(row[name]) for name in ("mesh", "way", "verified", "steps", "queries")), f"{row['p']:.3f}", path
        )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
