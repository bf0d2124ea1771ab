"""Registers the published network of IEP as an architecture. It needs no torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from services.targets.architectures import register_answering

if TYPE_CHECKING:
    from pathlib import Path

    import torch

    from services.targets.preprocessing import Preprocessing
    from services.targets.protocol import Target

NAME = "clevr-iep"
EXAMPLE = '[{"function":"scene","inputs":[]},{"function":"count","inputs":[0]}]'


@register_answering(NAME, EXAMPLE)
def load(name: str, file: Path, preprocessing: Preprocessing, dtype: torch.dtype) -> Target:
    """Loads converted weights. Raises ValueError if they do not fit."""
    from services.targets.iep_released.target import read

    return read(name, file, preprocessing, dtype)
