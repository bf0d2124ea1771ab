"""The data of a recipe: shards of drawn scenes and their questions, made where they are missing."""

import hashlib
import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.errors import InvalidRequest
from services.questions.executor import Facts
from services.questions.generator import QuestionGenerator
from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import generate
from services.scenes.library import Library
from training.iep import shards
from training.iep.drawing import coarse, draw, varied
from training.iep.examples import Example, ObjectTruth
from training.iep.processes import each
from training.iep.recipe import SHARD, Part, Recipe, Split

VERSION = 1
"""Changes with what is drawn, so that data of an older version is not taken for it."""

Said = Callable[[str, float, float, str], None]
"""Is told what is being done, how much of it is done, the total, and perhaps some figures."""


@dataclass(frozen=True)
class Piece:
    """The scenes of a shard: `count` of a part, from index `start` on."""

    part: Part
    start: int
    count: int


class DataFolder:
    """The shards of a recipe and a seed in a folder."""

    def __init__(self, folder: Path, recipe: Recipe, seed: int) -> None:
        self._folder, self._recipe, self._seed = folder, recipe, seed

    def pieces(self, split: Split) -> list[Piece]:
        """Returns the pieces of a split, those of each renderer together."""
        return [
            Piece(part, start, min(SHARD, part.scenes - start))
            for part in self._recipe.parts(split)
            for start in range(0, part.scenes, SHARD)
        ]

    def path(self, piece: Piece) -> Path:
        """Returns the path of a piece's shard."""
        return self._folder / f"{piece.part.name}-{piece.start // SHARD:04}.safetensors"

    def draw_missing(
        self, splits: Sequence[Split], library: Library, said: Said, over: Callable[[], bool], processes: int = 1
    ) -> bool:
        """Draws the shards that are not there, until it is over; returns whether all are there.

        Those of the first renderer come first. Each of the processes draws one shard at a time, and this one writes
        them all; their bits do not depend on the number of processes. A damaged shard that is there is found by `read`
        and `digest`. Raises JobFailure("worker-lost") if a process is killed.
        """
        order = list(self._recipe.shares)
        pieces = [piece for split in splits for piece in self.pieces(split)]
        pieces.sort(key=lambda piece: order.index(piece.part.renderer))
        total = sum(piece.count for piece in pieces)
        done = sum(piece.count for piece in pieces if self.path(piece).exists())
        missing = [piece for piece in pieces if not self.path(piece).exists()]
        with closing(each(partial(self._drawn, library=library), missing, processes, over)) as made:
            for piece, shard in made:
                shards.write(self.path(piece), shard, self._about(piece))
                done += piece.count
                said("drawing scenes", done, total, f"{done:,} of {total:,}, {piece.part.renderer}")
        return done == total

    def digest(self, split: Split) -> str:
        """Returns the digest of a split: that of its shards' digests. Raises InvalidRequest("--out") for a bad one."""
        found = [shards.digest(self.path(piece), self._about(piece)) for piece in self.pieces(split)]
        return hashlib.sha256("".join(found).encode()).hexdigest()

    def read(self, piece: Piece) -> shards.Shard:
        """Reads the shard of a piece. Raises InvalidRequest("--out") if it is damaged or of other settings."""
        return shards.read(self.path(piece), self._about(piece))

    def read_all(self, split: Split) -> list[shards.Shard]:
        """Reads all shards of a split."""
        return [self.read(piece) for piece in self.pieces(split)]

    def _about(self, piece: Piece) -> str:
        recipe, part = self._recipe, piece.part
        about = {
            "version": VERSION,
            "seed": self._seed,
            "part": part.name,
            "start": piece.start,
            "count": piece.count,
            "questions": recipe.questions,
            "varied": recipe.varied if part.split == "train" else 0.0,
        }
        return json.dumps(about)

    def _drawn(self, piece: Piece, library: Library) -> shards.Shard:
        recipe, part = self._recipe, piece.part
        asking = QuestionGenerator(self._seed)
        scenes, questions, images = [], [], []
        for index in range(piece.start, piece.start + piece.count):
            scene = generate(self._seed, index, objects=part.objects, split=part.name)
            described = describe(scene)
            if part.split == "train":
                random = np.random.default_rng([self._seed, zlib.crc32(part.name.encode()), index])
                vary = random.random() < recipe.varied
                described = coarse(varied(described, random) if vary else described)
            images.append(draw(described, part.renderer, library))
            questions += asking.ask(scene, recipe.questions)
            scenes.append(scene)
        return shards.shard(scenes, questions, images)


class Images:
    """The images of shards, by their number in all of them."""

    def __init__(self, of: Sequence[shards.Shard]) -> None:
        self._places = [(one, number) for one in of for number in range(len(one))]

    def __len__(self) -> int:
        return len(self._places)

    def __call__(self, chosen: Sequence[int] | NDArray[np.int64]) -> NDArray[np.uint8]:
        """Returns images, uint8 [n, 240, 320, 3]. Raises InvalidRequest("--out") for one that cannot be read."""
        try:
            return np.stack([one.image(number) for one, number in (self._places[k] for k in chosen)])
        except OSError as error:
            raise InvalidRequest("--out", f"an image of the data cannot be read: {error}") from error


def objects_of(of: Sequence[shards.Shard]) -> list[tuple[ObjectTruth, ...]]:
    """Returns the objects of each scene."""
    return [tuple(ObjectTruth.of(record) for record in scene.objects) for one in of for scene in one.scenes]


def examples_of(of: Sequence[shards.Shard]) -> Iterator[Example]:
    """Yields the questions as examples; their images are numbered as in `Images`."""
    starts = accumulate((len(one) for one in of), initial=0)
    for one, start in zip(of, starts, strict=False):
        facts = {scene.image_index: (start + k, Facts.of(scene)) for k, scene in enumerate(one.scenes)}
        for question in one.questions:
            number, known = facts[question.image_index]
            yield Example.of(number, question, known)
