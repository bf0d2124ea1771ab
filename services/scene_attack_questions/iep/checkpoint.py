"""The checkpoint of IEP: the weights of trunk, engine and program generator in one safetensors file of flat names.

Weights are in 8 bits (`scene_attack.targets.weights_file`), with a scale for each output of each module; biases and
normalisation are in float32. The metadata states what the weights stand for: the answers, the modules of each kind, the
words, the cells. A file with other answers, modules or words is refused, as its weights would be read as those of
others.
"""

import json
from dataclasses import dataclass
from pathlib import Path

from safetensors.torch import save
from torch import Tensor, nn

from scene_attack.errors import summary
from scene_attack.targets.weights_file import dequantize, quantize, read_tensors
from scene_attack_questions.executor import ANSWERS
from scene_attack_questions.iep.assembly import KINDS
from scene_attack_questions.iep.engine import Network
from scene_attack_questions.iep.program_generator import TOKENS, ProgramGenerator
from scene_attack_questions.text import WORDS

MAX_BYTES = 10_000_000
HOW_TO_GET_WEIGHTS = "restore the project's own, or train them: python -m training iep"
"""Advice for the case that the weights file is missing."""
COUNTS = "num_batches_tracked"
"""Ends the names of the buffers of batch normalisation that no checkpoint has."""


@dataclass(frozen=True)
class Checkpoint:
    """A network and the generator of its programs, in evaluation and without gradients of weights."""

    network: Network
    generator: ProgramGenerator


def to_bytes(network: Network, generator: ProgramGenerator) -> bytes:
    """Returns the checkpoint file. Raises ValueError if it has more than MAX_BYTES."""
    tensors = {
        f"{part}.{name}": value
        for part, module in (("network", network), ("generator", generator))
        for name, value in _stored(module).items()
    }
    data: bytes = save(tensors, _fixed() | {"cells": json.dumps(network.engine.stem.cells)})
    if len(data) > MAX_BYTES:
        raise ValueError(f"the checkpoint has {len(data)} bytes, more than {MAX_BYTES}")
    return data


def round_weights(module: nn.Module) -> None:
    """Rounds the weights of trunk, engine or generator to those that a checkpoint of them would have."""
    _restore(module, _stored(module))


def load(path: Path) -> Checkpoint:
    """Reads a checkpoint. Raises ValueError, which says why, if the file is not one of this code."""
    try:
        tensors, metadata = read_tensors(path)
    except (ValueError, OSError) as error:
        raise ValueError(f"{path.name} cannot be read: {error}") from error
    for name, expected in _fixed().items():
        if metadata.get(name) != expected:
            raise ValueError(f"{path.name} has other {name} than this version: {metadata.get(name)}")
    cells = metadata.get("cells", "")
    if not (cells.isascii() and cells.isdecimal()):
        raise ValueError(f"{path.name} has no number of cells: {cells!r}")
    network, generator = Network(int(cells)), ProgramGenerator()
    for part, module in (("network", network), ("generator", generator)):
        _load_into(module, part, tensors)
    return Checkpoint(network, generator)


def _load_into(module: nn.Module, part: str, tensors: dict[str, Tensor]) -> None:
    own = {name.removeprefix(f"{part}."): value for name, value in tensors.items() if name.startswith(f"{part}.")}
    try:
        _restore(module, own)
    except RuntimeError as error:
        raise ValueError(f"the weights do not fit: {summary(error)}") from error
    module.requires_grad_(False).eval()


def _stored(module: nn.Module) -> dict[str, Tensor]:
    """Returns the tensors of a module's weights as they are in a file."""
    state = {name: value.detach().float() for name, value in module.state_dict().items()}
    return quantize({name: _by_output(name, value) for name, value in state.items() if not name.endswith(COUNTS)})


def _restore(module: nn.Module, stored: dict[str, Tensor]) -> None:
    """Loads tensors of a file into a module. Raises RuntimeError if they are not those of its weights."""
    state = module.state_dict()
    values = {
        name: value.view_as(state[name]) if name in state and value.numel() == state[name].numel() else value
        for name, value in dequantize(stored).items()
        if value.is_floating_point()  # others have no scale
    }
    module.load_state_dict(values | {name: value for name, value in state.items() if name.endswith(COUNTS)})


def _by_output(name: str, value: Tensor) -> Tensor:
    """Returns weights so that the first axis is the outputs, of all modules of a stack; a bias as a vector."""
    if name.endswith("bias"):
        return value.flatten()
    return value.flatten(0, 1) if value.dim() == 3 and value.shape[2] > 1 else value


def _fixed() -> dict[str, str]:
    """Returns the metadata that every checkpoint of this code has."""
    known = {"answers": ANSWERS, "words": WORDS, "tokens": TOKENS, "modules": KINDS}
    return {name: json.dumps(value) for name, value in known.items()}
