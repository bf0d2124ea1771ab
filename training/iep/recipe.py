"""The training of IEP: the scenes of each split and their renderers, the questions, and the schedule of each part."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import accumulate
from typing import Any, Literal

from training.loop import Schedule

Split = Literal["train", "validation", "test"]
FEW, MANY = (3, 6), (3, 10)
"""Least and largest number of objects of the two kinds of scenes that accuracy is reported for."""
SHARD = 100
"""Scenes of a file of data."""


@dataclass(frozen=True)
class Part:
    """Scenes that are drawn by one renderer. objects: the least and the largest number of objects."""

    split: Split
    renderer: str
    objects: tuple[int, int]
    scenes: int

    @property
    def name(self) -> str:
        """The part's name; scenes of parts of different names are different."""
        return f"{self.split}-{self.renderer}-{self.objects[0]}-{self.objects[1]}"


@dataclass(frozen=True)
class Recipe:
    """Settings of a training.

    shares: the renderers that draw, each with its share of the scenes of every split. scenes: by split, and of the test
    split those of each kind. questions: asked about a scene. varied: the share of the training scenes whose lights,
    colours and environment are changed as attacks change them. batches: images, questions and questions of a step.
    """

    shares: Mapping[str, float]
    scenes: Mapping[Split, int]
    questions: int
    varied: float
    trunk: Schedule
    trunk_batch: int
    engine: Schedule
    engine_batch: int
    generator: Schedule
    generator_batch: int

    def parts(self, split: Split) -> list[Part]:
        """Returns the parts of a split, those of each renderer together."""
        sums = list(accumulate(self.shares.values()))
        ends = [0, *(round(self.scenes[split] * share / sums[-1]) for share in sums)]
        return [
            Part(split, renderer, kind, end - start)
            for renderer, start, end in zip(self.shares, ends[:-1], ends[1:], strict=True)
            for kind in ((FEW, MANY) if split == "test" else (MANY,))
            if end > start
        ]

    def scaled(self, scale: float) -> "Recipe":
        """Returns the recipe with that share of its scenes and steps, at least one of each."""
        if scale == 1:
            return self

        def of(count: int) -> int:
            return max(1, round(count * scale))

        return replace(
            self,
            scenes={split: of(count) for split, count in self.scenes.items()},
            trunk=replace(self.trunk, steps=of(self.trunk.steps)),
            engine=replace(self.engine, steps=of(self.engine.steps)),
            generator=replace(self.generator, steps=of(self.generator.steps)),
        )

    def written(self) -> dict[str, Any]:
        """Returns the settings as JSON has them."""
        return asdict(self)


RECIPE = Recipe(
    shares={"pyrender": 0.9, "torch": 0.1},
    scenes={"train": 12_000, "validation": 500, "test": 1_000},
    questions=12,
    varied=0.5,
    trunk=Schedule(steps=3_600, rate=4e-3, decay=0.02),
    trunk_batch=48,
    engine=Schedule(steps=20_000, rate=2e-3),
    engine_batch=64,
    generator=Schedule(steps=5_000, rate=4e-3),
    generator_batch=64,
)
