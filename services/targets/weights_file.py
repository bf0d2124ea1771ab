"""Reads a safetensors file of weights. A weight that is not finite is refused: it would make every score NaN."""

from pathlib import Path

from safetensors import SafetensorError, safe_open
from torch import Tensor

from services.finite import finite


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Returns the tensors of a file by name, and its metadata.

    Raises ValueError, which says why, if it is no safetensors file, or names the first tensor that is not finite.
    """
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no dictionary
    except SafetensorError as error:
        raise ValueError(f"it is no safetensors file: {error}") from error
    for name, value in tensors.items():
        if value.is_floating_point() and value.numel() and not finite(value.float()):
            raise ValueError(f"{name} has values that are not finite")
    return tensors, metadata
