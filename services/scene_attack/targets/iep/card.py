"""Registers IEP as a target. Its weights are `weights/iep.safetensors`, in the folder of the networks that ship."""

from __future__ import annotations

from typing import TYPE_CHECKING

from scene_attack.targets.info import TargetInfo, register, shipped
from scene_attack_questions.executor import ANSWERS

if TYPE_CHECKING:
    import torch

    from scene_attack.targets.protocol import Target

CARD = TargetInfo(
    name="iep",
    title="Inferring and executing programs, CLEVR's 28 answers",
    task="question answering",
    input_size=(240, 320),
    classes=len(ANSWERS),
    differentiable=True,
    takes_question=True,
    source="trained by this project: python -m training iep",
    licence="Apache-2.0",
    vocabulary="clevr",
    example="How many things are there?",
)


@register(CARD, lambda: ANSWERS)
def load(dtype: torch.dtype) -> Target:
    """Loads the network. Raises InvalidRequest("target.name") if its weights are missing or are not this version's."""
    from scene_attack.targets.iep.target import read

    return read(CARD.name, shipped(f"{CARD.name}.safetensors"), dtype)
