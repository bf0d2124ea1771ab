"""Measures how many queries a surrogate saves in p-rgf: the same search with and without another network's gradient.
Writes results/surrogates.json.

Each view is attacked through the pixels, the normals and pyrender's 14 parameters, by p-rgf with a surrogate and
without; `pairs` is the number of random directions of a step, so that the search without a surrogate asks for two
queries fewer a step. Both have the same seed, limits and budget. `queries` counts all of the target's queries, the
verifier's among them. Views are of models that neither furniture network was trained on and whose ImageNet label is
known, and only those that the target gets right. A success is a verified adversary; a run that held counts with all of
its queries, so that `without`, the queries of the search without a surrogate over those with it, is a lower bound
wherever that search held more often.
"""

import argparse
from collections.abc import Iterator
from itertools import product, zip_longest
from pathlib import Path
from statistics import fmean
from time import monotonic

import torch

from benchmarks.report import RESULTS, save
from client.settings import settings_to_run
from services.attacks.attack import ATTACKS
from services.attacks.problem import AttackProblem
from services.attacks.run import Budget, run
from services.attacks.seeds import derived
from services.errors import InvalidRequest
from services.pipeline.prepare import Prepared, prepare
from services.pipeline.spec import parse
from services.rendering.opengl import context
from services.rendering.pyrender_renderer.declaration import PYRENDER
from services.scenes.furniture_kinds import PREFIX
from services.scenes.library import Library
from services.targets import registry
from services.targets.info import TARGETS
from services.targets.labels import truth_labels
from training.split import committed

SEED = 0
ALEXNET, RESNET, LITE0 = "alexnet-furniture", "resnet34-furniture", "efficientnet-lite0"
SURROGATES = {ALEXNET: (None, RESNET, LITE0), RESNET: (None, ALEXNET, LITE0)}
"""The surrogates of each target; None: none."""
EPSILON = {
    "image": {"image": 8 / 255},
    "torch": {"normals": 0.1},
    "pyrender": {group.name: group.suggested_limit for group in PYRENDER.groups if group.by_default},
}
"""The attacked groups of each renderer, and their limits."""


def main() -> None:
    """Runs the attacks and writes the result; see --help."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=8, help="views of each target (default 8)")
    parser.add_argument("--queries", type=int, default=150, help="budget of a run (default 150)")
    parser.add_argument("--pairs", type=int, default=4, help="random directions of a step (default 4)")
    parser.add_argument("--rate", type=float, default=0.25, help="Adam's learning rate, in ε (default 0.25)")
    parser.add_argument("--targets", nargs="+", default=[ALEXNET, RESNET], choices=SURROGATES)
    parser.add_argument("--renderers", nargs="+", default=list(EPSILON), choices=EPSILON)
    parser.add_argument("--out", type=Path, default=RESULTS / "surrogates.json")
    options = parser.parse_args()
    settings = settings_to_run()
    torch.set_num_threads(settings.threads)
    library = Library(settings.cache_dir, settings.data_dir)
    backend = f"{context.gl_backend()}; torch {torch.__version__} {torch.get_num_threads()} threads"
    rows: list[dict[str, object]] = []
    weights = {name: registry.load(name).weights_sha256 for name in (ALEXNET, RESNET, LITE0)}
    for target, renderer in product(options.targets, options.renderers):
        for mesh in right(library, target, renderer, options.views):
            rows += [_attack(library, mesh, target, renderer, one, options) for one in SURROGATES[target]]
            # written after every view: a run that is stopped leaves what it has found
            used = {"pairs": options.pairs, "rate": options.rate, "budget": options.queries, "weights": weights}
            save(options.out, str(__doc__).split("\n\n")[0], backend, SEED, **used, summary=summary(rows), rows=rows)


def right(library: Library, target: str, renderer: str, count: int) -> Iterator[str]:
    """The first `count` held-out meshes that the target gets right at the default camera, kind by kind in turn."""
    held_out = committed().held_out
    drawn = [sorted(slugs, key=lambda slug: derived(SEED, "surrogates", slug)) for _, slugs in sorted(held_out.items())]
    for slug in (one for turn in zip_longest(*drawn) for one in turn if one is not None):
        if count == 0:
            return
        mesh = PREFIX + slug
        if not truth_labels(TARGETS[LITE0].info, mesh):
            continue
        try:
            found = _prepared(library, mesh, target, {"renderer": renderer})
        except InvalidRequest:
            continue
        if int(found.logits.argmax()) in found.truth:
            yield mesh
            count -= 1


def _prepared(library: Library, mesh: str, target: str, attack: dict[str, object]) -> Prepared:
    scene = {"objects": [{"mesh": mesh}], "camera": {"size": [224, 224]}}
    return prepare(parse({"scene": scene, "target": {"name": target}, "attack": attack, "seed": SEED}), library)


def _attack(
    library: Library, mesh: str, target: str, renderer: str, surrogate: str | None, options: argparse.Namespace
) -> dict[str, object]:
    epsilon = EPSILON[renderer]
    attack = {
        "method": "p-rgf",
        "renderer": renderer,
        "groups": list(epsilon),
        "surrogate": surrogate,
        "pairs": options.pairs,
        "epsilon": epsilon,
        "learning_rate": {group: options.rate * limit for group, limit in epsilon.items()},
    }
    ready = _prepared(library, mesh, target, attack)
    chosen = ready.spec.attack
    problem = AttackProblem(
        ready.renderer,
        ready.target,
        ready.goal,
        chosen.groups,
        seed=SEED,
        epsilon=chosen.epsilon,
        surrogate=ready.surrogate,
    )
    begun = monotonic()
    found = run(
        problem, ATTACKS["p-rgf"].method(chosen, problem), ready.verifier, Budget(chosen.steps, options.queries)
    )
    last = found.trace[-1]
    row: dict[str, object] = {
        "target": target,
        "renderer": renderer,
        "surrogate": surrogate,
        "mesh": mesh,
        "verified": found.verified,
        "steps": found.step,
        "queries": last.queries,
        "surrogate queries": last.surrogate_queries,
        "renders": last.renders,
        "p": last.perceptibility,
        "advantage": [found.trace[0].advantage, min(row.advantage for row in found.trace)],
        "seconds": monotonic() - begun,
    }
    print(*row.values(), flush=True)
    return row


def summary(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """For each target, renderer and surrogate: the successes, the queries, and how often the search without a surrogate
    needs as many.
    """
    found: dict[tuple[object, ...], list[dict[str, object]]] = {}
    for row in rows:
        found.setdefault((row["target"], row["renderer"], row["surrogate"]), []).append(row)
    lines = []
    for (target, renderer, surrogate), of in found.items():
        without = found[target, renderer, None]
        lines.append(
            {
                "target": target,
                "renderer": renderer,
                "surrogate": surrogate,
                "views": len(of),
                "verified": sum(bool(row["verified"]) for row in of),
                "queries": _sum(of),
                "fall": fmean(row["advantage"][0] - row["advantage"][1] for row in of),  # type: ignore[index]
                "without": None if len(without) != len(of) else _sum(without) / _sum(of),
            }
        )
    return lines


def _sum(rows: list[dict[str, object]]) -> int:
    return sum(int(str(row["queries"])) for row in rows)


if __name__ == "__main__":
    main()
