"""The checkpoint of IEP: the weights of trunk, engine and program generator in one safetensors file of flat names.

Its metadata states what the weights stand for: the answers, the modules of each kind, the words, the cells. A file
with other answers, modules or words is refused, as its weights would be read as those of others.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from services.questions.answers import ANSWERS
from services.questions.text import WORDS
from services.targets.iep.network import Network
from services.targets.iep.prefix import TOKENS
from services.targets.iep.program_generator import ProgramGenerator
from services.targets.iep.vocabulary import KINDS

MAX_BYTES = 10_000_000


@dataclass(frozen=True)
class Checkpoint:
    """A network and the generator of its programs, in evaluation and without gradients of weights."""

    network: Network
    generator: ProgramGenerator


def to_bytes(network: Network, generator: ProgramGenerator) -> bytes:
    """Returns the checkpoint file, weights in float32. Raises ValueError if it has more than MAX_BYTES."""
    tensors = {
        f"{part}.{name}": value.detach().float().contiguous()
        for part, module in (("network", network), ("generator", generator))
        for name, value in module.state_dict().items()
        if not name.endswith("num_batches_tracked")
    }
    data: bytes = save(tensors, _fixed() | {"cells": json.dumps(network.engine.stem.cells)})
    if len(data) > MAX_BYTES:
        raise ValueError(f"the checkpoint has {len(data)} bytes, more than {MAX_BYTES}")
    return data


def load(path: Path) -> Checkpoint:
    """Reads a checkpoint. Raises ValueError, which says why, if the file is not one of this code."""
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - it is no dictionary
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    for name, expected in _fixed().items():
        if metadata.get(name) != expected:
            raise ValueError(f"{path} has other {name} than this version: {metadata.get(name)}")
    network, generator = Network(json.loads(metadata["cells"])), ProgramGenerator()
    for part, module in (("network", network), ("generator", generator)):
        _load_into(module, part, tensors)
    return Checkpoint(network, generator)


def _load_into(module: nn.Module, part: str, tensors: dict[str, Tensor]) -> None:
    own = {name.removeprefix(f"{part}."): value for name, value in tensors.items() if name.startswith(f"{part}.")}
    counts = {name: torch.tensor(0) for name in module.state_dict() if name.endswith("num_batches_tracked")}
    try:
        module.load_state_dict(own | counts)
    except RuntimeError as error:
        raise ValueError(f"the weights do not fit: {error}") from error
    module.requires_grad_(False).eval()


def _fixed() -> dict[str, str]:
    """Returns the metadata that every checkpoint of this code has."""
    known = {"answers": ANSWERS, "words": WORDS, "tokens": TOKENS, "modules": KINDS}
    return {name: json.dumps(value) for name, value in known.items()}
