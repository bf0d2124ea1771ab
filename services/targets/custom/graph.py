"""Runs a network that was read from a file as a list of steps: the reader of .pt2 files builds these."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn


class Unreadable(ValueError):
    """A model file cannot be used; the message says why, in words for the person who made the file."""


@dataclass(frozen=True)
class Value:
    """A reference to the result of an earlier step, a weight, or the input."""

    name: str


class InputDevice:
    """Stands for the device of the input, where a file names the device on which it was made."""


@dataclass(frozen=True)
class Step:
    """One operation."""

    label: str
    """The operator and its place, for error messages."""
    run: Callable[..., Any]
    inputs: tuple[Any, ...]
    outputs: tuple[str, ...]
    keywords: Mapping[str, Any] = field(default_factory=dict)


class GraphNetwork(nn.Module):
    """A frozen network of steps. It maps its one input to its one output, both tensors."""

    def __init__(self, source: str, result: str, steps: Sequence[Step], weights: Mapping[str, Tensor]) -> None:
        """`source` and `result` name input and output. Raises Unreadable if a step refers to a value that no step
        makes.
        """
        super().__init__()
        self._source, self._result, self._steps = source, result, tuple(steps)
        self._buffer = {name: f"weight_{index}" for index, name in enumerate(weights)}
        for name, value in weights.items():
            self.register_buffer(self._buffer[name], value)
        self._last = self._last_uses()

    def _last_uses(self) -> dict[int, list[str]]:
        """The values that are not needed any more after each step."""
        known, last = {self._source, *self._buffer}, dict[str, int]()
        for index, step in enumerate(self._steps):
            for name in _names((step.inputs, tuple(step.keywords.values()))):
                if name not in known:
                    raise Unreadable(f"{step.label} needs {name!r:.80}, which nothing before it makes")
                last[name] = index
            known |= set(step.outputs)
            last |= dict.fromkeys(step.outputs, index)
        if self._result not in known:
            raise Unreadable(f"nothing makes its output {self._result!r:.80}")
        last.pop(self._result, None)
        unused: dict[int, list[str]] = {}
        for name, index in last.items():
            if name not in self._buffer:
                unused.setdefault(index, []).append(name)
        return unused

    def forward(self, x: Tensor) -> Tensor:
        """Returns the output of the input x. Raises RuntimeError, naming the step, for a step that fails."""
        values: dict[str, Any] = {name: getattr(self, buffer) for name, buffer in self._buffer.items()}
        values[self._source] = x
        for index, step in enumerate(self._steps):
            inputs = _resolved(step.inputs, values, x.device)
            keywords = {name: _resolved(value, values, x.device) for name, value in step.keywords.items()}
            try:
                output = step.run(*inputs, **keywords)
            except (RuntimeError, TypeError, ValueError, IndexError) as error:
                raise RuntimeError(f"{step.label}: {error}") from error
            if len(step.outputs) == 1:
                values[step.outputs[0]] = output
            else:
                values.update(zip(step.outputs, output, strict=False))
            for name in self._last.get(index, ()):
                values.pop(name, None)
        result: Tensor = values[self._result]
        return result


def _names(of: Any) -> Iterator[str]:
    if isinstance(of, Value):
        yield of.name
    elif isinstance(of, tuple | list):
        for item in of:
            yield from _names(item)


def _resolved(of: Any, values: Mapping[str, Any], device: torch.device) -> Any:
    if isinstance(of, Value):
        return values[of.name]
    if isinstance(of, InputDevice):
        return device
    if isinstance(of, tuple | list):
        return type(of)(_resolved(item, values, device) for item in of)
    return of


class FixedBatch(nn.Module):
    """Runs a network whose file fixes the number of images, `count`, on any number of images.

    The images are passed in portions; the last portion is filled up with its last image.
    """

    def __init__(self, network: nn.Module, count: int) -> None:
        super().__init__()
        self.network, self.count = network, count

    def forward(self, x: Tensor) -> Tensor:
        """Maps inputs [B, ...] to outputs [B, ...]."""
        outputs = []
        for portion in x.split(self.count):  # type: ignore[no-untyped-call]
            missing = self.count - len(portion)
            full = torch.cat([portion, portion[-1:].expand(missing, *portion.shape[1:])]) if missing else portion
            outputs.append(self.network(full)[: len(portion)])
        return torch.cat(outputs)


def check_input(shape: Sequence[int | None], size: tuple[int, int]) -> int | None:
    """Returns the number of images that an input's shape fixes, None for any number; None in `shape` is any length.

    Raises Unreadable unless it takes RGB images [B, 3, height, width] of `size`.
    """
    shown = " × ".join("any" if length is None else str(length) for length in shape)
    if len(shape) != 4 or shape[1] not in (None, 3):
        raise Unreadable(f"its input is {shown}; images [B, 3, height, width] are due")
    if any(length not in (None, expected) for length, expected in zip(shape[2:], size, strict=True)):
        raise Unreadable(
            f"its input is {shown}, but the card's preprocessing.input_size is {size[0]}×{size[1]} (height × width)"
        )
    return shape[0]
