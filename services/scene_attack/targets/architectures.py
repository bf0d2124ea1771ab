"""The registry of architectures: networks without weights, for weights in a safetensors file. It needs no torch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from scene_attack.plugins import Registry

if TYPE_CHECKING:
    from torch import Tensor, nn

Build = Callable[[int], "nn.Module"]
Builder = TypeVar("Builder", bound=Build)
Fill = Callable[["nn.Module", Mapping[str, "Tensor"]], None]


def fill_by_name(network: "nn.Module", state: Mapping[str, "Tensor"]) -> None:
    """Loads weights under the network's own names. Raises ValueError, which names what is missing or left over."""
    missing, unexpected = [], []
    own = network.state_dict()
    missing = [name for name in own if name not in state and not name.endswith("num_batches_tracked")]
    unexpected = [name for name in state if name not in own]
    if missing or unexpected:
        raise ValueError("; ".join([*_listed("it lacks", missing), *_listed("it has too many", unexpected)]))
    for name, value in own.items():
        if name in state and state[name].shape != value.shape:
            shape, expected = list(state[name].shape), list(value.shape)
            raise ValueError(f"{name} has the shape {shape}; {expected} is due")
    network.load_state_dict(dict(state), strict=False)


def _listed(words: str, names: list[str]) -> list[str]:
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return [f"{words} {shown}"] if names else []


@dataclass(frozen=True)
class Architecture:
    """A registered architecture: the function that builds it, and the one that fills in weights."""

    build: Build
    fill: Fill


ARCHITECTURES: Registry[Architecture] = Registry("architecture", ["scene_attack.targets.image_networks"])


def register_architecture(name: str, fill: Fill = fill_by_name) -> Callable[[Builder], Builder]:
    """Returns a decorator of the function that builds an architecture, given the number of classes.

    The module must not import torch when it is imported; the function does. `fill` loads weights by name into the
    network, for an architecture whose published names are not those of its module; it raises ValueError or KeyError for
    weights that do not fit. Raises ValueError for a name that is taken.
    """

    def decorate(build: Builder) -> Builder:
        ARCHITECTURES.add(name, Architecture(build, fill))
        return build

    return decorate
