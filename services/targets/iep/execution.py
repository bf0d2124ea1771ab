"""The results of all nodes of an assembled network, and the gathering of results for the modules that take them."""

from collections.abc import Sequence

import torch
from torch import Tensor

from services.targets.iep.assembly import Assembly, Call, Slot
from services.targets.iep.modules import Maps
from services.targets.iep.stem import Candidates
from services.targets.iep.trunk import GRID
from services.targets.iep.vocabulary import MAPPED


class Execution:
    """The results of an assembly on a batch of images."""

    def __init__(self, assembly: Assembly, candidates: Candidates, maps: Sequence[Maps], scores: Sequence[Tensor]):
        self.assembly = assembly
        self.candidates = candidates
        self._logits = [stack.logits for stack in maps]
        self._masks = [stack.weights for stack in maps]
        self._scores = scores

    @property
    def scores(self) -> Tensor:
        """The scores [Q, 28] of the answers to the questions."""
        return self.answer_scores([slots[-1] for slots in self.assembly.slots])

    def answer_scores(self, slots: Sequence[Slot]) -> Tensor:
        """Returns the scores [n, 28] of vectors: of roots, and of counts and queries inside a program."""
        return rows(self._scores, slots)

    def mask_logits(self, slots: Sequence[Slot]) -> Tensor:
        """Returns the logits [n, P] of the masks of maps, at the cells of `candidates.cells` of each one's image."""
        return rows(self._logits, slots)

    def attention(self, question: int, node: int) -> Tensor:
        """Returns the mask [15, 20] in [0,1] of a node of a question; a cell is high if an object of the set is there.

        Raises ValueError if the node's result is no set and no object.
        """
        program, slot = self.assembly.questions[question].program, self.assembly.slots[question][node]
        if program.types[node] not in MAPPED:
            raise ValueError(f"node {node} is {program.nodes[node].label}, which has no attention mask")
        mask = rows(self._masks, [slot])[0, :, 0]
        whole = mask.new_zeros(GRID[0] * GRID[1])
        return whole.scatter(0, self.candidates.cells[slot.image], mask).view(GRID)


def rows(stacks: Sequence[Tensor], slots: Sequence[Slot]) -> Tensor:
    """Returns the rows at `slots`, of which there is one at least, of stacks of results."""
    taken: dict[int, list[int]] = {}
    for place, slot in enumerate(slots):
        taken.setdefault(slot.stack, []).append(place)
    parts = [selected(stacks[stack], [slots[place].row for place in places]) for stack, places in taken.items()]
    if len(parts) == 1:
        return parts[0]
    order = {place: at for at, place in enumerate(place for places in taken.values() for place in places)}
    return selected(torch.cat(parts), [order[place] for place in range(len(slots))])


def map_inputs(stacks: Sequence[Maps], calls: Sequence[Call]) -> list[Maps]:
    """Returns for each input of calls the stack of its maps, a row for each call."""
    fields = list(zip(*stacks, strict=True))
    inputs = zip(*(call.inputs for call in calls), strict=True)
    return [Maps(*(rows(field, slots) for field in fields)) for slots in inputs]


def vector_inputs(stacks: Sequence[Tensor], calls: Sequence[Call]) -> list[Tensor]:
    """Returns for each input of calls the stack of its vectors, a row for each call."""
    return [rows(stacks, slots) for slots in zip(*(call.inputs for call in calls), strict=True)]


def selected(stack: Tensor, places: Sequence[int]) -> Tensor:
    """Returns the rows of a stack at some places; the stack itself, and no copy, if these are all, in order."""
    return stack if list(places) == list(range(len(stack))) else stack.index_select(0, long(places, stack))


def joined(parts: Sequence[Tensor]) -> Tensor:
    """Returns the concatenation of tensors; a single one itself, and no copy."""
    return parts[0] if len(parts) == 1 else torch.cat(list(parts))


def long(values: Sequence[int], like: Tensor) -> Tensor:
    """Returns integers as int64 on the device of another tensor."""
    return torch.tensor(values, dtype=torch.int64, device=like.device)
