"""Reads a .safetensors file into a registered architecture."""

from pathlib import Path

from torch import nn

from services.targets import weights_file
from services.targets.architectures import Architecture
from services.targets.custom.graph import Unreadable


def read(path: Path, name: str, known: Architecture, classes: int) -> nn.Module:
    """Returns the network of an architecture with the weights of the file.

    Raises Unreadable if the file is no safetensors file, has a weight that is not finite, or does not fit; names what
    is missing or left over.
    """
    try:
        state, _ = weights_file.read(path)
    except ValueError as error:
        raise Unreadable(str(error)) from error
    network = known.build(classes)
    try:
        known.fill(network, state)
    except KeyError as error:
        raise Unreadable(f"it does not fit {name} with {classes} classes: it lacks {error.args[0]}") from error
    except (ValueError, RuntimeError) as error:
        raise Unreadable(f"it does not fit {name} with {classes} classes: {error}") from error
    return network
