"""Weights in safetensors files, as they are and in 8 bits: symmetric, one scale for each output channel.

A weight that is not finite is refused: it would make every score NaN.

In 8 bits a tensor `<name>` of two or more dimensions is stored as int8 [outputs, …] with `<name>.scale` float32
[outputs]; its value is their product. A matrix may be a product of two, `<name>.left` and `<name>.right`, each stored
so. Vectors (biases, normalisation) are float32.
"""

from collections.abc import Mapping
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from scene_attack.process import finite
from scene_attack.targets.architectures import fill_by_name

LARGEST = 127
"""Largest magnitude of a stored integer."""
FACTORS = (".left", ".right")
SCALE = ".scale"


def read_tensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
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


def quantize(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns the tensors to store for float32 weights."""
    stored = {}
    for name, value in state.items():
        if value.dim() < 2:
            stored[name] = value.float().contiguous()
            continue
        scale = value.detach().flatten(1).abs().amax(1).clamp_min(torch.finfo(torch.float32).tiny) / LARGEST
        shaped = scale.view(-1, *[1] * (value.dim() - 1))
        stored[name] = (value / shaped).round().clamp(-LARGEST, LARGEST).to(torch.int8).contiguous()
        stored[name + SCALE] = scale.float()
    return stored


def dequantize(stored: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Returns float32 weights of stored tensors, products multiplied out."""
    values = _floats(stored)
    left, right = FACTORS
    for name in [name for name in values if name.endswith(left)]:
        whole = name.removesuffix(left)
        values[whole] = values.pop(name) @ values.pop(whole + right)
    return values


def _floats(stored: Mapping[str, Tensor]) -> dict[str, Tensor]:
    values = {}
    for name, value in stored.items():
        if name.endswith(SCALE):
            continue
        scale = stored.get(name + SCALE)
        values[name] = value if scale is None else value.float() * scale.view(-1, *[1] * (value.dim() - 1))
    return values


def to_bytes(state: Mapping[str, Tensor]) -> bytes:
    """Returns the safetensors file of float32 weights."""
    return save(quantize(state))


def read(path: Path) -> dict[str, Tensor]:
    """Returns the float32 weights of a file in 8 bits."""
    return dequantize(read_tensors(path)[0])


def load_in_factors(network: nn.Module, path: Path) -> None:
    """Loads a file's weights into a network of their names. A matrix that is a product of two becomes two layers.

    The product is the same function with fewer numbers: AlexNet's two of rank 256 are 6 million instead of 54 million,
    which every image has to read. Raises ValueError as `fill_by_name` does, and for a weight that is not finite.
    """
    state = _floats(read_tensors(path)[0])
    left, right = FACTORS
    for name in [name for name in state if name.endswith(left)]:
        whole = name.removesuffix(left)
        layer = whole.removesuffix(".weight")
        outer, inner = state.pop(name), state.pop(whole + right)
        two = nn.Sequential(
            nn.Linear(inner.shape[1], inner.shape[0], bias=False), nn.Linear(outer.shape[1], outer.shape[0])
        )
        network.set_submodule(layer, two, strict=True)
        state |= {f"{layer}.0.weight": inner, f"{layer}.1.weight": outer, f"{layer}.1.bias": state.pop(f"{layer}.bias")}
    fill_by_name(network, state)
