"""A recipe of a few scenes and steps."""

from pathlib import Path

from scene_attack.scenes.library import Library
from training.iep.recipe import Recipe
from training.iep.stages import Stages
from training.loop import Schedule

RECIPE = Recipe(
    shares={"pyrender": 1.0},
    scenes={"train": 3, "validation": 1, "test": 1},
    questions=4,
    varied=0.5,
    trunk=Schedule(steps=3, rate=1e-3, decay=0.02),
    trunk_batch=2,
    engine=Schedule(steps=4, rate=1e-3),
    engine_batch=4,
    generator=Schedule(steps=4, rate=1e-3),
    generator_batch=4,
)
SEED = 5


def silent(what: str, done: float, total: float, words: str) -> None:
    assert 0 <= done <= total
    assert what
    assert isinstance(words, str)


def never() -> bool:
    return False


class After:
    """Is over when it has been asked so many times."""

    def __init__(self, times: int) -> None:
        self.left = times

    def __call__(self) -> bool:
        self.left -= 1
        return self.left < 0


def stages(folder: Path, library: Library, recipe: Recipe = RECIPE, over=never) -> Stages:
    return Stages(recipe, SEED, folder, library, silent, over)
