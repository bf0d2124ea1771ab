"""Registers IEP as a target. Its weights are `iep.safetensors` beside this file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from scene_attack.plugin import TargetInfo, register_target
from scene_attack_questions.executor import ANSWERS

if TYPE_CHECKING:
    import torch

    from scene_attack.targets.protocol import Target

CARD = TargetInfo(
    name="iep",
    title="Inferring and executing programs, CLEVR's 28 answers",
    task="questions",
    input_size=(240, 320),
    classes=len(ANSWERS),
    differentiable=True,
    source="trained by this project: python -m training iep",
    licence="Apache-2.0",
    vocabulary="clevr",
    example="How many things are there?",
)


@register_target(CARD, lambda: ANSWERS)
def load(dtype: torch.dtype) -> Target:
    """Loads the network. Raises InvalidRequest("target.name") if its weights are missing or are not this version's."""
    from scene_attack_questions.iep.target import read

    return read(CARD.name, Path(__file__).with_name(f"{CARD.name}.safetensors"), dtype)
