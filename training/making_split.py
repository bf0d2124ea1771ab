"""Makes the split from the library: families, the division, Lite0's features, the choice of classes."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from services.scenes.description import ELEVATION, Environment
from services.scenes.furniture import read_catalogue
from services.scenes.furniture_kinds import PREFIX, kinds
from services.scenes.library import Library
from services.scenes.mesh import Mesh
from training.batches import plain, shade
from training.classes import VIEWS, Samples, choose, folds
from training.families import families
from training.looks import environment_look
from training.split import MIN_MODELS, Split, divided
from training.teacher import SIZE, features_of, load
from training.views import paper_cameras, views

Say = Callable[[str], None]


def make(library: Library, cache: Path, seed: int, command: str, say: Say) -> Split:
    """Returns the split for a seed. `say` gets a line for each step; drawn views are kept in `cache`."""
    catalogue = read_catalogue(cache / "furniture", cache / "meshes" / "catalogue.json")
    many = {kind: [name.removeprefix(PREFIX) for name in names] for kind, names in kinds().items()}
    many = {kind: slugs for kind, slugs in many.items() if len(slugs) >= MIN_MODELS}

    def mesh(slug: str) -> Mesh:
        say(f"reading {slug}")
        return library.mesh(PREFIX + slug)

    grouped = families(catalogue, many, mesh)
    training, held_out = divided(grouped, seed)
    found = features(library, training, cache / "training" / "views", say)
    of_family = {slug: group[0] for groups in grouped.values() for group in groups for slug in group}
    slugs = [(number, slug) for number, kind in enumerate(training) for slug in training[kind]]
    fold = {slug: number for kind in training.values() for slug, number in folds(of_family, kind).items()}
    samples = Samples(
        torch.cat([found[slug] for _, slug in slugs]),
        torch.tensor([number for number, _ in slugs]).repeat_interleave(VIEWS),
        torch.tensor([fold[slug] for _, slug in slugs]).repeat_interleave(VIEWS),
    )
    chosen, accuracy, recalls, rounds = choose(
        samples, list(training), lambda r: say(f"{r.kinds} kinds {r.accuracy:.3f}: drop {r.dropped} {r.recall:.3f}")
    )
    return Split(
        command=command,
        seed=seed,
        classes=tuple(chosen),
        accuracy=accuracy,
        recalls=recalls,
        rounds=tuple(rounds),
        training={kind: tuple(training[kind]) for kind in chosen},
        held_out={kind: tuple(held_out[kind]) for kind in chosen},
        families={kind: tuple(tuple(group) for group in grouped[kind] if len(group) > 1) for kind in chosen},
    )


def features(library: Library, by_kind: Mapping[str, Sequence[str]], folder: Path, say: Say) -> dict[str, Tensor]:
    """Returns EfficientNet-Lite0's features [VIEWS, 1280] of each model in the torch renderer's default light."""
    teacher = load()
    table = environment_look(library, Environment(), "matte", ELEVATION)[None]
    found = {}
    for kind, slugs in by_kind.items():
        for slug in slugs:
            say(f"looking at {kind} {slug}")
            drawn = views(library, PREFIX + slug, paper_cameras(VIEWS, SIZE), folder)
            at = np.arange(VIEWS)
            images = shade(drawn, table, plain(at, np.zeros_like(at)))
            found[slug] = features_of(teacher, images)
    return found
