"""Trains the engine on questions, over features of a frozen trunk that were computed before."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.iep.assembly import Question, Slot, assemble
from scene_attack_questions.iep.engine import N_CELLS, Engine, Execution
from training.iep.examples import Example

SHORTEST, EVERYTHING_FROM = 8, 0.2
"""Nodes of the programs that a training begins with, and the progress from which all programs are drawn."""


def chances(examples: Sequence[Example]) -> NDArray[np.float64]:
    """Returns how likely each example is drawn; the sum is 1.

    An example's is proportional to 1/√(the share of examples with its rarest function), so rare functions are seen more
    often than they are asked about.
    """
    labels = [{node.label for node in example.program.nodes} for example in examples]
    counts = Counter(label for of_example in labels for label in of_example)
    rarest = np.array([min(counts[label] for label in of_example) for of_example in labels], np.float64)
    weights: NDArray[np.float64] = 1 / np.sqrt(rarest)
    return weights / float(weights.sum())


class Draw:
    """Draws batches of examples: short programs first, rare functions more often, and several questions on an image."""

    def __init__(self, examples: Sequence[Example], batch: int, per_image: int = 4):
        """Prepares batches of `batch` examples, about `per_image` of them on each image."""
        order = sorted(range(len(examples)), key=lambda index: examples[index].image)
        self._images = np.array([examples[index].image for index in order])
        self._order = np.array(order)
        self._chances = chances([examples[index] for index in order])
        self._lengths = np.array([len(examples[index].program.nodes) for index in order])
        self._batch, self._per_image = min(batch, len(examples)), per_image

    def __call__(self, progress: float, random: np.random.Generator) -> list[int]:
        """Returns the indices of the examples of a batch at a progress in [0, 1]; none is in it twice."""
        weights = self._chances * (self._lengths <= self.longest(progress))
        n_first = min(self._n_images, int(np.count_nonzero(weights)))
        first = random.choice(len(weights), n_first, replace=False, p=weights / weights.sum())
        of_chosen_images = np.zeros(self._images[-1] + 1, np.bool_)
        of_chosen_images[self._images[first]] = True
        there = np.flatnonzero(of_chosen_images[self._images] & (weights > 0))
        own = weights[there] / weights[there].sum()
        chosen = random.choice(there, min(self._batch, len(there)), replace=False, p=own)
        return [int(index) for index in self._order[np.sort(chosen)]]

    def longest(self, progress: float) -> float:
        """Returns the most nodes of a program that is drawn at a progress in [0, 1]."""
        if progress >= EVERYTHING_FROM:
            return np.inf
        least, most = max(SHORTEST, self._lengths.min()), self._lengths.max()
        return float(least + (most - least) * progress / EVERYTHING_FROM)

    @property
    def _n_images(self) -> int:
        return -(-self._batch // self._per_image)


def execute(engine: Engine, features: Tensor, examples: Sequence[Example]) -> Execution:
    """Runs the programs of examples; `features` [V, 96, 15, 20] are of all images, in any floating type."""
    images = sorted({example.image for example in examples})
    place = {image: number for number, image in enumerate(images)}
    assembly = assemble([Question(example.program, place[example.image]) for example in examples])
    weights = next(engine.parameters())
    execution: Execution = engine(features[images].to(weights.dtype).to(weights.device), assembly)
    return execution


def engine_step(
    engine: Engine, features: Tensor, examples: Sequence[Example], cells: Sequence[Sequence[int]], batch: int
) -> Callable[[float, np.random.Generator], tuple[Tensor, dict[str, float]]]:
    """Returns the step of a training loop. cells: for each image those of its objects' centres."""
    draw = Draw(examples, batch)

    def step(progress: float, random: np.random.Generator) -> tuple[Tensor, dict[str, float]]:
        chosen = [examples[index] for index in draw(progress, random)]
        loss = engine_loss(execute(engine, features, chosen), chosen, [cells[example.image] for example in chosen])
        return loss.total, loss.parts()

    return step


MASK_WEIGHT = 0.5
"""Weight of the loss on masks."""
INNER_WEIGHT = 0.5
"""Weight of the loss on counts and queries inside a program."""
POSITIVE_WEIGHT = 4.0
"""Weight of a cell that holds an object, in the loss on masks: most cells hold none."""
NUMBERS = {word: number for number, word in enumerate(ANSWERS)}


@dataclass(frozen=True)
class EngineLoss:
    """The parts of the engine's loss.

    answers: mean cross-entropy. masks: mean binary cross-entropy over masks and cells, of `scene` at all cells plus of
    the modules at the cells they work at. inner: as `answers`, of counts and queries inside programs; zero without any.
    """

    answers: Tensor
    masks: Tensor
    inner: Tensor

    @property
    def total(self) -> Tensor:
        """The weighted sum."""
        return self.answers + MASK_WEIGHT * self.masks + INNER_WEIGHT * self.inner

    def parts(self) -> dict[str, float]:
        """The parts as numbers."""
        return {name: float(value.detach()) for name, value in vars(self).items()}


def engine_loss(execution: Execution, examples: Sequence[Example], cells: Sequence[Sequence[int]]) -> EngineLoss:
    """Returns the loss of an execution of the examples' programs.

    cells: for each example the cell in [0, 300) of every object's centre.
    A subprogram that questions share is counted once for each of them.
    """
    maps: list[Slot] = []
    objects: list[list[int]] = []
    inner: list[Slot] = []
    words: list[str] = []
    scenes: dict[int, list[int]] = {}
    for example, slots, of_image in zip(examples, execution.assembly.slots, cells, strict=True):
        scenes[slots[0].image] = list(of_image)
        for node, slot, result in zip(example.program.nodes[:-1], slots[:-1], example.results[:-1], strict=True):
            if isinstance(result, str):
                inner.append(slot)
                words.append(result)
            elif node.function not in ("scene", "unique"):  # the mask of `unique` is its input's
                maps.append(slot)
                objects.append([of_image[index] for index in result])
    scores = execution.scores
    candidates = execution.candidates
    masks = mask_loss(candidates.scene[list(scenes)], occupancy(list(scenes.values()), scores))
    if maps:
        there = candidates.cells[[slot.image for slot in maps]]
        masks = masks + mask_loss(execution.mask_logits(maps), occupancy(objects, scores).gather(1, there))
    return EngineLoss(
        _cross_entropy(scores, [example.answer for example in examples]),
        masks,
        _cross_entropy(execution.answer_scores(inner), words) if inner else scores.new_zeros(()),
    )


def occupancy(cells: Sequence[Sequence[int]], like: Tensor) -> Tensor:
    """Returns [n, 300], which is 1 at the given cells of each row and 0 elsewhere."""
    occupied = like.new_zeros(len(cells), N_CELLS)
    occupied[
        [row for row, of_row in enumerate(cells) for _ in of_row], [cell for of_row in cells for cell in of_row]
    ] = 1.0
    return occupied


def mask_loss(logits: Tensor, truth: Tensor) -> Tensor:
    """Returns the mean binary cross-entropy of mask logits with a truth of 0 and 1, of the same shape."""
    return F.binary_cross_entropy_with_logits(logits, truth, pos_weight=logits.new_tensor(POSITIVE_WEIGHT))


def _cross_entropy(scores: Tensor, words: Sequence[str]) -> Tensor:
    return F.cross_entropy(scores, torch.tensor([NUMBERS[word] for word in words], device=scores.device))
