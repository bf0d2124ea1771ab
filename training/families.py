"""Families of near-copies among the library's models: no family may be on both sides of a split.

Two models of one kind belong to one family if any of these rules holds, and families are closed under them:

- the same creator made both, unless the creator is a studio (at least `STUDIO` models of the library): a hobbyist's
  models of one kind are mostly one set, and so are the people of one library in several poses;
- the same studio made both and their file names agree up to the first digit ("window_2x3.obj", "window_4x5.obj");
- their shapes are nearly equal: with each bounding box scaled to a unit cube, the mean distance from a point of either
  surface to the other surface is below `NEARLY_EQUAL` in one of four turns about the vertical.
"""

import posixpath
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from services.scenes.furniture import Model
from services.scenes.mesh import Doubles, Mesh

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
    made = Counter(model.creator for model in models.values())
    found = {}
    for kind, slugs in by_kind.items():
        clouds = {slug: cKDTree(_cloud(mesh(slug))) for slug in slugs}
        parent = {slug: slug for slug in slugs}
        for a, b in combinations(slugs, 2):
            if _root(parent, a) == _root(parent, b):
                continue
            if _related(models[a], models[b], made) or _distance(clouds[a], clouds[b]) < NEARLY_EQUAL:
                parent[_root(parent, b)] = _root(parent, a)
        groups: dict[str, list[str]] = {}
        for slug in slugs:
            groups.setdefault(_root(parent, slug), []).append(slug)
        found[kind] = sorted(groups.values(), key=lambda group: (-len(group), group))
    return found


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
    found = []
    turned = np.asarray(b.data)
    back = np.asarray(a.data)
    for _ in range(4):
        some = float(a.query(turned[:: POINTS // FEW])[0].mean())
        found.append(some)
        if some < 2 * NEARLY_EQUAL:
            found[-1] = float(a.query(turned)[0].mean() + b.query(back)[0].mean()) / 2
        turned = np.stack([turned[:, 2], turned[:, 1], -turned[:, 0]], axis=1)
        back = np.stack([-back[:, 2], back[:, 1], back[:, 0]], axis=1)
    return min(found)


def _related(a: Model, b: Model, made: Mapping[str, int]) -> bool:
    if a.creator != b.creator:
        return False
    return made[a.creator] < STUDIO or (a.library == b.library and stem(a) == stem(b))


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
