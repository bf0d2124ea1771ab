"""Chooses the classes by cross-validation inside the training models; the held-out models play no part.

The probe is multinomial logistic regression on EfficientNet-Lite0's features of `VIEWS` views a model. All kinds take
part at first. In each round the kind with the lowest cross-validated recall is dropped, until `CLASSES` are left.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from training.split import Round

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
    found: dict[str, int] = {}
    for name in sorted(members, key=lambda name: (-len(members[name]), name)):
        fold = filled.index(min(filled))
        filled[fold] += len(members[name])
        found |= dict.fromkeys(members[name], fold)
    return found


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
