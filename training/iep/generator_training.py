"""Trains the program generator on questions and their programs."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from scene_attack.errors import InvalidRequest
from scene_attack_questions.iep.program_generator import TOKENS, ProgramGenerator, to_prefix
from scene_attack_questions.text import encoded
from training.iep.examples import Example

PADDING = -1
"""Marks the places after the end of a program; no loss is taken there."""
NUMBERS = {token: number for number, token in enumerate(TOKENS)}


def generator_step(
    generator: ProgramGenerator, examples: Sequence[Example], batch: int
) -> Callable[[float, np.random.Generator], tuple[Tensor, dict[str, float]]]:
    """Returns the step of a training loop. Raises InvalidRequest for a question with a word outside the language."""
    questions = [encoded(example.text) for example in examples]
    programs = [torch.tensor([NUMBERS[token] for token in to_prefix(example.program)]) for example in examples]

    def step(_: float, random: np.random.Generator) -> tuple[Tensor, dict[str, float]]:
        chosen = random.choice(len(examples), min(batch, len(examples)), replace=False)
        tokens = torch.nn.utils.rnn.pad_sequence([programs[index] for index in chosen], True, PADDING)
        scores = generator([questions[index] for index in chosen], tokens.clamp_min(0))
        loss = F.cross_entropy(scores.flatten(0, 1), tokens.flatten(), ignore_index=PADDING)
        return loss, {"tokens": float(loss.detach())}

    return step


def right_programs(generator: ProgramGenerator, examples: Sequence[Example], batch: int = 256) -> list[bool]:
    """Returns for each example whether the generator writes exactly its program."""
    generator.eval()
    right = []
    for start in range(0, len(examples), batch):
        some = examples[start : start + batch]
        for example, program in zip(some, generator.generate([item.text for item in some]), strict=True):
            right.append(not isinstance(program, InvalidRequest) and to_prefix(program) == to_prefix(example.program))
    return right
