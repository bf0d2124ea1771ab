"""The split: classes, and the models of each class for training and held out, by family.

`python -m training split` writes the committed one. Its rule: of each kind with at least `MIN_MODELS` models, whole
families are held out, in the order of a hash of the seed and the family's first model, until `HELD_OUT` of the models
are; a family that would take more than `AT_MOST` is passed over. Kinds with fewer than `MIN_FAMILIES` training families
or fewer than `MIN_HELD_OUT` held-out ones are left out.

Families are near-copies: no family may be on both sides of a split. Two models of one kind belong to one family if any
of these rules holds, and families are closed under them:

- the same creator made both, unless the creator is a studio (at least `STUDIO` models of the library): a hobbyist's
  models of one kind are mostly one set, and so are the people of one library in several poses;
- the same studio made both and their file names agree up to the first digit ("window_2x3.obj", "window_4x5.obj");
- their shapes are nearly equal: with each bounding box scaled to a unit cube, the mean distance from a point of either
  surface to the other surface is below `NEARLY_EQUAL` in one of four turns about the vertical.

The classes are then chosen by cross-validation among the training models alone. The probe is multinomial logistic
regression on EfficientNet-Lite0's features of `VIEWS` views a model. All kinds take part at first. In each round the
kind with the lowest cross-validated recall is dropped, until `CLASSES` are left.
"""

import hashlib
import posixpath
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional as F

from scene_attack import disk
from scene_attack.scenes.description import ELEVATION, Environment
from scene_attack.scenes.furniture import PREFIX, Model, kinds, read_catalogue
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import Doubles, Mesh
from training.batches import plain, shade
from training.looks import environment_look
from training.teacher import SIZE, features_of, load
from training.views import paper_cameras, views

MIN_MODELS = 9
MIN_FAMILIES, MIN_HELD_OUT = 5, 2
HELD_OUT, AT_MOST = 0.25, 0.35
PATH = Path(__file__).with_name("split.json")

Families = Mapping[str, Sequence[Sequence[str]]]
"""Families of slugs by kind."""


class Round(BaseModel):
    """A round of the choice of classes: the kind with the lowest cross-validated recall, which was dropped."""

    model_config = ConfigDict(frozen=True)

    kinds: int
    accuracy: float
    dropped: str
    recall: float


class Split(BaseModel):
    """Training and held-out models (slugs) by kind, their families of more than one model, and the chosen classes.

    accuracy: the cross-validated accuracy of the chosen classes among the training models, a linear probe on
    EfficientNet-Lite0's features. rounds: how the classes were chosen.
    """

    model_config = ConfigDict(frozen=True)

    command: str
    seed: int
    classes: tuple[str, ...]
    accuracy: float
    recalls: dict[str, float]
    rounds: tuple[Round, ...]
    training: dict[str, tuple[str, ...]]
    held_out: dict[str, tuple[str, ...]]
    families: dict[str, tuple[tuple[str, ...], ...]]

    def family(self, kind: str, slug: str) -> str:
        """Returns the name of a model's family: its first model."""
        return next((group[0] for group in self.families.get(kind, ()) if slug in group), slug)

    def models(self, side: str) -> list[tuple[int, str]]:
        """Returns (class number, slug) of the models of one side ("training" or "held_out"), class by class."""
        chosen = self.training if side == "training" else self.held_out
        return [(number, slug) for number, kind in enumerate(self.classes) for slug in chosen[kind]]


def divided(families: Families, seed: int) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Returns the training and the held-out models of every kind that has enough of both (see the module)."""
    training, held_out = {}, {}
    for kind, groups in families.items():
        total = sum(map(len, groups))
        out: list[Sequence[str]] = []
        for group in sorted(groups, key=lambda group: _order(seed, group)):
            taken = sum(map(len, out))
            if taken < HELD_OUT * total and taken + len(group) <= AT_MOST * total:
                out.append(group)
        kept = [group for group in groups if group not in out]
        if total >= MIN_MODELS and len(kept) >= MIN_FAMILIES and len(out) >= MIN_HELD_OUT:
            training[kind] = sorted(slug for group in kept for slug in group)
            held_out[kind] = sorted(slug for group in out for slug in group)
    return training, held_out


@cache
def committed() -> Split:
    """Returns the committed split."""
    return Split.model_validate_json(PATH.read_bytes())


def save(split: Split, path: Path = PATH) -> None:
    """Writes a split."""
    disk.write(path, (split.model_dump_json(indent=1) + "\n").encode())


def _order(seed: int, group: Sequence[str]) -> str:
    return hashlib.sha256(f"{seed}:{min(group)}".encode()).hexdigest()


Say = Callable[[str], None]


def make(library: Library, cache: Path, seed: int, command: str, say: Say) -> Split:
    """Returns the split for a seed. `say` gets a line for each step; drawn views are kept in `cache`."""
    catalogue = read_catalogue(cache / "furniture")
    many = {kind: [name.removeprefix(PREFIX) for name in names] for kind, names in kinds().items()}
    many = {kind: slugs for kind, slugs in many.items() if len(slugs) >= MIN_MODELS}

    def mesh(slug: str) -> Mesh:
        say(f"reading {slug}")
        return library.mesh(PREFIX + slug)

    grouped = families(catalogue, many, mesh)
    training, held_out = divided(grouped, seed)
    by_slug = features(library, training, cache / "training" / "views", say)
    of_family = {slug: group[0] for groups in grouped.values() for group in groups for slug in group}
    slugs = [(number, slug) for number, kind in enumerate(training) for slug in training[kind]]
    fold = {slug: number for kind in training.values() for slug, number in folds(of_family, kind).items()}
    samples = Samples(
        torch.cat([by_slug[slug] for _, slug in slugs]),
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
    by_slug = {}
    for kind, slugs in by_kind.items():
        for slug in slugs:
            say(f"looking at {kind} {slug}")
            drawn = views(library, PREFIX + slug, paper_cameras(VIEWS, SIZE), folder)
            at = np.arange(VIEWS)
            images = shade(drawn, table, plain(at, np.zeros_like(at)))
            by_slug[slug] = features_of(teacher, images)
    return by_slug


STUDIO = 60
"""Models of the library from which a creator counts as a studio, whose models of one kind differ."""
POINTS = 2048
"""Points that are sampled on a surface. Two samples of one surface are about 0.016 apart."""
FEW = 128
"""Points by which clouds that are far apart are told."""
NEARLY_EQUAL = 0.03
"""Mean distance of surfaces below which shapes count as nearly equal, in edges of the bounding box."""


def families(
    models: Mapping[str, Model], by_kind: Mapping[str, Sequence[str]], mesh: Callable[[str], Mesh]
) -> dict[str, list[list[str]]]:
    """Returns the families of each kind, {kind: [[slug, …], …]}, largest first.

    `models` is the whole catalogue by slug, `by_kind` the slugs of each kind to be grouped, `mesh` loads a slug's mesh.
    """
    by_creator = Counter(model.creator for model in models.values())
    grouped = {}
    for kind, slugs in by_kind.items():
        clouds = {slug: cKDTree(_cloud(mesh(slug))) for slug in slugs}
        parent = {slug: slug for slug in slugs}
        for a, b in combinations(slugs, 2):
            if _root(parent, a) == _root(parent, b):
                continue
            if _related(models[a], models[b], by_creator) or _distance(clouds[a], clouds[b]) < NEARLY_EQUAL:
                parent[_root(parent, b)] = _root(parent, a)
        groups: dict[str, list[str]] = {}
        for slug in slugs:
            groups.setdefault(_root(parent, slug), []).append(slug)
        grouped[kind] = sorted(groups.values(), key=lambda group: (-len(group), group))
    return grouped


def stem(model: Model) -> str:
    """Returns the model's file name up to its first digit, in lower-case letters: "window_2x3.obj" → "window"."""
    name = posixpath.splitext(posixpath.basename(model.path))[0]
    return re.sub(r"[^a-z]", "", re.split(r"\d", name, maxsplit=1)[0].lower())


def distance(a: Doubles, b: Doubles) -> float:
    """Returns the smallest symmetric mean distance of two clouds of points [n, 3] over four turns about +y.

    A turn in which a few points are far apart is judged by those.
    """
    return _distance(cKDTree(a), cKDTree(b))


def _distance(a: cKDTree, b: cKDTree) -> float:
    distances = []
    turned = np.asarray(b.data)
    back = np.asarray(a.data)
    for _ in range(4):
        some = float(a.query(turned[:: POINTS // FEW])[0].mean())
        distances.append(some)
        if some < 2 * NEARLY_EQUAL:
            distances[-1] = float(a.query(turned)[0].mean() + b.query(back)[0].mean()) / 2
        turned = np.stack([turned[:, 2], turned[:, 1], -turned[:, 0]], axis=1)
        back = np.stack([-back[:, 2], back[:, 1], back[:, 0]], axis=1)
    return min(distances)


def _related(a: Model, b: Model, by_creator: Mapping[str, int]) -> bool:
    if a.creator != b.creator:
        return False
    return by_creator[a.creator] < STUDIO or (a.library == b.library and stem(a) == stem(b))


def _root(parent: Mapping[str, str], slug: str) -> str:
    while parent[slug] != slug:
        slug = parent[slug]
    return slug


def _cloud(mesh: Mesh) -> Doubles:
    """Returns POINTS points on the mesh's surface, uniform by area, its bounding box scaled to a unit cube."""
    corners = np.concatenate([part.vertices[part.faces] for part in mesh.parts]).astype(np.float64)
    low, high = corners.min((0, 1)), corners.max((0, 1))
    corners = (corners - (low + high) / 2) / np.maximum(high - low, 1e-9)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    random = np.random.default_rng(0)
    at = corners[random.choice(len(corners), POINTS, p=areas / areas.sum())]
    u, v = random.random((2, POINTS, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points: Doubles = at[:, 0] + u * (at[:, 1] - at[:, 0]) + v * (at[:, 2] - at[:, 0])
    return points


CLASSES = 14
FOLDS = 4
VIEWS = 4
PENALTY = 1e-2
"""Weight of the squared norm of the probe's weights, per sample."""
ITERATIONS = 40


@dataclass(frozen=True)
class Samples:
    """Features [N, F] of views, the kind of each by number [N], and the fold of its family [N]."""

    features: Tensor
    kinds: Tensor
    folds: Tensor


def folds(groups: Mapping[str, str], kind: Sequence[str]) -> dict[str, int]:
    """Returns the fold of each model {slug: fold}; the families of a kind go round the folds, the largest first.

    `groups` gives each slug's family; `kind` lists the slugs of one kind.
    """
    members: dict[str, list[str]] = {}
    for slug in kind:
        members.setdefault(groups[slug], []).append(slug)
    filled = [0] * FOLDS
    fold_of: dict[str, int] = {}
    for name in sorted(members, key=lambda name: (-len(members[name]), name)):
        fold = filled.index(min(filled))
        filled[fold] += len(members[name])
        fold_of |= dict.fromkeys(members[name], fold)
    return fold_of


def choose(
    samples: Samples, names: Sequence[str], said: Callable[[Round], None]
) -> tuple[list[str], float, dict[str, float], list[Round]]:
    """Returns the chosen classes, their cross-validated accuracy and recalls, and the rounds, which `said` gets too."""
    kept, rounds = list(range(len(names))), list[Round]()
    while True:
        accuracy, recalls = cross_validated(samples, kept)
        if len(kept) <= CLASSES:
            chosen = [names[kind] for kind in kept]
            return chosen, accuracy, {names[kind]: value for kind, value in recalls.items()}, rounds
        worst = min(kept, key=lambda kind: (recalls[kind], names[kind]))
        rounds.append(Round(kinds=len(kept), accuracy=accuracy, dropped=names[worst], recall=recalls[worst]))
        said(rounds[-1])
        kept.remove(worst)


def cross_validated(samples: Samples, kept: Sequence[int]) -> tuple[float, dict[int, float]]:
    """Returns accuracy and recall of each of the `kept` kinds, each view judged by the probe of the other folds."""
    among = torch.isin(samples.kinds, torch.tensor(list(kept)))
    places = {kind: place for place, kind in enumerate(kept)}
    x = samples.features[among]
    y = torch.tensor([places[int(kind)] for kind in samples.kinds[among]])
    fold = samples.folds[among]
    right = torch.zeros(len(y), dtype=torch.bool)
    for number in range(FOLDS):
        own = fold == number
        right[own] = probe(x[~own], y[~own], x[own], len(kept)) == y[own]
    recalls = {kind: float(right[y == place].double().mean()) for kind, place in places.items()}
    return float(right.double().mean()), recalls


def probe(x: Tensor, y: Tensor, asked: Tensor, classes: int) -> Tensor:
    """Returns the classes [M] of features `asked` [M, F] by logistic regression on x [N, F] of classes y [N]."""
    mean, scale = x.mean(0), x.std(0) + 1e-3
    x, asked = (x - mean) / scale, (asked - mean) / scale
    weights = torch.zeros(x.shape[1] + 1, classes, requires_grad=True)
    optimiser = torch.optim.LBFGS([weights], max_iter=ITERATIONS, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimiser.zero_grad()
        value = F.cross_entropy(x @ weights[:-1] + weights[-1], y) + PENALTY * weights[:-1].square().sum()
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimiser.step(loss)  # type: ignore[no-untyped-call]
    with torch.no_grad():
        return (asked @ weights[:-1] + weights[-1]).argmax(1)
