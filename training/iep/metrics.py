"""How often answers are right: overall and by family of questions, with confidence intervals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from services.questions.executor import ANSWERS
from services.statistics import wilson
from services.targets.iep.engine import Engine
from training.iep.engine_training import execute
from training.iep.examples import Example

OVERALL = "overall"


@dataclass(frozen=True)
class Share:
    """The share of right answers. interval: Wilson's, of 95 %."""

    right: int
    of: int

    @property
    def share(self) -> float:
        """In [0,1]."""
        return self.right / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Its ends."""
        return wilson(self.right, self.of)


@torch.no_grad()
def answers(engine: Engine, features: Tensor, examples: Sequence[Example], batch: int = 64) -> list[str]:
    """Returns the engine's answers, given the true programs; `features` as for `execute`."""
    engine.eval()
    found: list[str] = []
    for start in range(0, len(examples), batch):
        scores = execute(engine, features, examples[start : start + batch]).scores
        found += [ANSWERS[number] for number in scores.argmax(1).tolist()]
    return found


def by_family(examples: Sequence[Example], right: Sequence[bool]) -> dict[str, Share]:
    """Returns the shares of right answers of each family, and overall, of one example at least."""
    return {OVERALL: Share(sum(right), len(right))} | _grouped(examples, right, lambda example: {example.family})


def by_function(examples: Sequence[Example], right: Sequence[bool]) -> dict[str, Share]:
    """Returns the shares of right answers of the examples with each function in their programs."""
    return _grouped(examples, right, lambda example: {node.label for node in example.program.nodes})


def _grouped(
    examples: Sequence[Example], right: Sequence[bool], names: Callable[[Example], set[str]]
) -> dict[str, Share]:
    counted: dict[str, list[bool]] = {}
    for example, one in zip(examples, right, strict=True):
        for name in names(example):
            counted.setdefault(name, []).append(one)
    return {name: Share(sum(of), len(of)) for name, of in sorted(counted.items())}
