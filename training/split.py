"""The committed split: classes, and the models of each class for training and held out, by family.

`python -m training split` writes it. Its rule: of each kind with at least `MIN_MODELS` models, whole families are held
out, in the order of a hash of the seed and the family's first model, until `HELD_OUT` of the models are; a family that
would take more than `AT_MOST` is passed over. Kinds with fewer than `MIN_FAMILIES` training families or fewer than
`MIN_HELD_OUT` held-out ones are left out. The classes are then chosen among the rest from the training models alone
(`classes`).
"""

import hashlib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from services import disk

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
