"""The losses of the trunk and of the engine."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from services.questions.executor import ANSWERS
from services.targets.iep.assembly import Slot
from services.targets.iep.engine import N_CELLS, Execution
from training.iep.examples import Example

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
                objects.append([of_image[one] for one in result])
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
    made = like.new_zeros(len(cells), N_CELLS)
    made[[row for row, of_row in enumerate(cells) for _ in of_row], [cell for of_row in cells for cell in of_row]] = 1.0
    return made


def mask_loss(logits: Tensor, truth: Tensor) -> Tensor:
    """Returns the mean binary cross-entropy of mask logits with a truth of 0 and 1, of the same shape."""
    return F.binary_cross_entropy_with_logits(logits, truth, pos_weight=logits.new_tensor(POSITIVE_WEIGHT))


def _cross_entropy(scores: Tensor, words: Sequence[str]) -> Tensor:
    return F.cross_entropy(scores, torch.tensor([NUMBERS[word] for word in words], device=scores.device))
