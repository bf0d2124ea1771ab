"""Engines with one departure from the published network undone.

Each is made of the project's engine and differs from it in one thing. In all of them sets and objects pass between
modules as masks, at the 64 cells that are likeliest to hold an object, so the variants are not the published network.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from benchmarks.iep_unique import assemble_with_unique, named
from services.targets.iep.assembly import Assembly, Question, assemble
from services.targets.iep.engine import Engine
from services.targets.iep.execution import Execution
from services.targets.iep.modules import WIDTH, MapModules, Maps, Seen, attend, of, random
from services.targets.iep.stem import N_CELLS
from services.targets.iep.trunk import GRID
from services.targets.iep.vocabulary import JOINING, MAPPING
from services.training.iep.examples import Example
from services.training.iep.losses import engine_loss


@dataclass(frozen=True)
class Variant:
    """An engine, how programs are assembled, and its loss given an execution, examples and the objects' cells."""

    name: str
    build: Callable[[], Engine]
    assemble: Callable[[Sequence[Question]], Assembly]
    loss: Callable[[Execution, Sequence[Example], Sequence[Sequence[int]]], Tensor]

    def execute(self, engine: Engine, features: Tensor, examples: Sequence[Example]) -> Execution:
        """Runs the programs of examples; `features` [V, 96, 15, 20] are of all images, in any floating type."""
        images = sorted({example.image for example in examples})
        place = {image: number for number, image in enumerate(images)}
        assembly = self.assemble([Question(example.program, place[example.image]) for example in examples])
        execution: Execution = engine(features[images].float(), assembly)
        return execution


def supervised(execution: Execution, examples: Sequence[Example], cells: Sequence[Sequence[int]]) -> Tensor:
    """The loss of the project: answers, masks, and counts and queries inside programs."""
    return engine_loss(execution, examples, cells).total


def answers_alone(execution: Execution, examples: Sequence[Example], cells: Sequence[Sequence[int]]) -> Tensor:
    """The published loss."""
    return engine_loss(execution, examples, cells).answers


def with_unique(execution: Execution, examples: Sequence[Example], cells: Sequence[Sequence[int]]) -> Tensor:
    """The loss of the project, also on the masks of the modules of `unique`."""
    return engine_loss(execution, [named(example) for example in examples], cells).total


def without_attention() -> Engine:
    """Modules see the image's features, its coordinates and the masks of their inputs, and nothing of what these attend
    to: neither its features nor coordinates relative to it."""
    engine = Engine()
    for modules in (engine.mapping, engine.joining, engine.reading):
        for weights in (modules.first.scaled, modules.first.attended, modules.first.relative):
            nn.init.zeros_(weights).requires_grad_(False)
    return engine


def with_neighbours() -> Engine:
    """Residual blocks of modules that give a map are two 3×3 convolutions."""
    engine = Engine()
    engine.mapping = NeighbourModules(len(MAPPING), 1)
    engine.joining = NeighbourModules(len(JOINING), 2)
    return engine


def with_module_of_unique() -> Engine:
    """`unique` has a module, after all others of one map."""
    engine = Engine()
    engine.mapping = MapModules(len(MAPPING) + 1, 1)
    return engine


class NeighbourModules(MapModules):
    """Map modules whose residual block has 3×3 convolutions; cells that modules do not work at count as zero."""

    def __init__(self, modules: int, inputs: int):
        super().__init__(modules, inputs)
        self.second = random(modules, WIDTH, 9 * WIDTH, 9 * WIDTH)
        self.third = random(modules, WIDTH, 9 * WIDTH, 4 * 9 * WIDTH)

    def forward(self, chosen: Tensor, seen: Seen, inputs: Sequence[Maps]) -> Maps:
        """Returns n maps, as `MapModules` does."""
        cells = cells_of(seen)
        x = self.first(chosen, seen, inputs)
        y = torch.bmm(of(self.second, chosen), neighbours(x, cells)).add_(of(self.second_bias, chosen)).relu_()
        x = torch.baddbmm(x + of(self.third_bias, chosen), of(self.third, chosen), neighbours(y, cells)).relu_()
        return attend(torch.bmm(of(self.mask, chosen), x).add_(of(self.mask_bias, chosen))[:, 0], seen)


def cells_of(seen: Seen) -> Tensor:
    """Returns the cells that are seen, int64 [B, P], from their coordinates."""
    height, width = GRID
    column, row = (seen.features[:, WIDTH:] * width).unbind(1)
    return ((row + height - 1) / 2 * width + (column + width - 1) / 2).round().long()


def neighbours(x: Tensor, cells: Tensor) -> Tensor:
    """Returns for activations [n, 64, P] at cells [n, P] or [1, P] those of the 3×3 cells around, [n, 64·9, P]."""
    places = cells.expand(len(x), -1)[:, None]
    grid = x.new_zeros(*x.shape[:2], N_CELLS).scatter(2, places.expand_as(x), x)
    windows = F.unfold(grid.unflatten(2, GRID), 3, padding=1)
    return windows.gather(2, places.expand(-1, windows.shape[1], -1))


VARIANTS = (
    Variant("as it is", Engine, assemble, supervised),
    Variant("answers alone supervised", Engine, assemble, answers_alone),
    Variant("modules do not see what is attended to", without_attention, assemble, supervised),
    Variant("3×3 convolutions in residual blocks", with_neighbours, assemble, supervised),
    Variant("`unique` has a module of its own", with_module_of_unique, assemble_with_unique, with_unique),
)
