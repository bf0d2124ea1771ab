"""Assembles the training data of a network: views of the training models, looks, hints of a teacher."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from services.scenes.description import ELEVATION, Environment
from services.scenes.furniture import PREFIX
from services.scenes.library import Library
from training.batches import plain, shade
from training.looks import default_looks, environment_look, looks
from training.teacher import features_of, load
from training.training import Data, Recipe
from training.views import INPUT, Views, joined, training_cameras, views

HINTS = 256
"""Principal components of the teacher's features that are kept as hints."""
TEACHER_SIZE = (160, 160)
"""Size of the images that the teacher sees: smaller than its own, and twice as fast."""
TURNS = 24
"""Sides from which the default scene's light comes."""
AT_ONCE = 32
"""Views that the teacher looks at together."""


def gather(
    library: Library,
    cache: Path,
    recipe: Recipe,
    models: Sequence[tuple[int, str]],
    seed: int,
    said: Callable[[str, int, int], None],
) -> Data:
    """Returns the data of a recipe: `models` are (class, slug). Drawn views and hints are kept in `cache`.

    `said` gets a step's name, the amount done, and the total.
    """
    parts = []
    for _, slug in models:
        cameras = training_cameras(PREFIX + slug, recipe.views, seed, INPUT)
        parts.append(views(library, PREFIX + slug, cameras, cache / "training" / "views"))
        said("drawing models", len(parts), len(models))
    drawn = joined(parts)
    labels = torch.tensor([number for number, _ in models]).repeat_interleave(recipe.views)
    said("tabulating looks", 0, 1)
    tables, default = looks(library, recipe.looks, seed), default_looks(library, TURNS)
    hints = None if recipe.hints == 0 else _hints(library, drawn, said)
    return Data(drawn, labels, tables, default, hints)


def _hints(library: Library, drawn: Views, said: Callable[[str, int, int], None]) -> Tensor:
    """Returns the teacher's features of each view in the default light, as principal components of unit variance."""
    teacher = load()
    table = environment_look(library, Environment(), "matte", ELEVATION)[None]
    count = drawn.count
    batches = []
    for start in range(0, count, AT_ONCE):
        at = np.arange(start, min(start + AT_ONCE, count))
        images = shade(drawn, table, plain(at, np.zeros_like(at)))
        batches.append(features_of(teacher, F.interpolate(images, TEACHER_SIZE, mode="bilinear")))
        said("asking the teacher", start + len(at), count)
    features = torch.cat(batches)
    centred = features - features.mean(0)
    values, vectors = torch.linalg.eigh((centred.T @ centred / len(centred)).double())
    kept = slice(max(0, len(values) - HINTS), None)
    scaled: Tensor = centred.double() @ vectors[:, kept] / values[kept].clamp_min(1e-12).sqrt()
    return scaled.float()
