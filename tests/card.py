"""A CUDA device for machines without one: its tensors lie in the computer's memory, and must not meet the CPU's.

It shows what ends a job on a real device: a tensor of the device that meets one of the CPU, or that is asked for its
memory. It does not show what CUDA computes otherwise, nor what meets in another thread or inside a backward pass, where
torch hands on gradients that do not say where they are, nor a network's parameters that stayed on the CPU.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

CARD, HOST = torch.device("cuda", 0), torch.device("cpu")
MOVES = {"to", "cpu", "cuda", "copy_"}
JOINS = {"stack", "cat"}
"""Those of our functions that refuse even a tensor without axes of another device."""
BACKWARD = (torch.autograd.grad, torch.autograd.backward, Tensor.backward)


class OnCard(Tensor):
    """A tensor of the device. Torch gives what is computed from one the same class."""


class Card(TorchFunctionMode):
    """While it is entered, torch knows the device `CARD`."""

    def __torch_function__(
        self, func: Callable[..., Any], types: object, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        del types
        kwargs, name = kwargs or {}, getattr(func, "__name__", "")
        if name == "__get__":
            return _attribute(func, args[0])
        if func is torch.device or name == "_parse_to":  # of which modules ask where to move
            return func(*args, **kwargs)
        if func in BACKWARD:
            return _differentiated(func, args, kwargs)
        tensors = list(_tensors([*args, *kwargs.values()]))
        on_card = any(isinstance(tensor, OnCard) for tensor in tensors)
        if on_card and name in ("numpy", "__array__"):
            raise TypeError("can't convert cuda:0 device type tensor to numpy")
        if on_card and name not in MOVES:
            _check(name, args, tensors)
        device = _device(name, args, kwargs)
        if name in ("cpu", "cuda"):
            func, args, kwargs = Tensor.clone, args[:1], {}
        result = func(*(_at_home(of) for of in args), **{key: _at_home(of) for key, of in kwargs.items()})
        return result if device is None else _placed(result, device)


@contextmanager
def card() -> Iterator[None]:
    """In the block torch has one CUDA device, "cuda:0"."""
    deterministic = torch.are_deterministic_algorithms_enabled()
    with (
        patch("torch.cuda.is_available", lambda: True),
        patch("torch.cuda.device_count", lambda: 1),
        patch("torch.cuda.get_device_name", lambda _: "a card of the tests"),
        Card(),
    ):
        try:
            yield
        finally:
            torch.use_deterministic_algorithms(deterministic)


def _attribute(func: Callable[..., Any], of: Tensor) -> Any:
    if not isinstance(of, OnCard):
        return func(of)
    whole = getattr(func, "__self__", None)
    answers = {Tensor.device: CARD, Tensor.is_cuda: True, Tensor.is_cpu: False}
    if whole in answers:
        return answers[whole]
    value = func(of)
    return _placed(value, CARD) if whole in (Tensor.grad, Tensor.data) else value


def _differentiated(func: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    """Runs a backward pass, which this mode does not see. A gradient is on the device of its input."""
    found = func(*args, **kwargs)
    if func is not torch.autograd.grad:
        return found
    inputs = args[1] if len(args) > 1 else kwargs["inputs"]
    inputs = [inputs] if isinstance(inputs, Tensor) else inputs
    return tuple(
        _placed(of, CARD if isinstance(into, OnCard) else HOST) for of, into in zip(found, inputs, strict=True)
    )


def _check(name: str, args: tuple[Any, ...], tensors: list[Tensor]) -> None:
    """Raises RuntimeError, as torch does, where tensors of both devices meet. Allowed are the CPU's tensors without
    axes, and its indices into a tensor of the device. A network's parameters count as on either device, because moving
    them loses the mark."""
    if name in ("__getitem__", "__setitem__") and isinstance(args[0], OnCard):
        tensors = [*_tensors(args[2:])]  # what is put in
    for tensor in tensors:
        if not isinstance(tensor, OnCard | nn.Parameter) and (tensor.dim() > 0 or name in JOINS):
            raise RuntimeError(f"Expected all tensors to be on the same device, but found cuda:0 and cpu: {name}")


def _device(name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> torch.device | None:
    """The device that a call asks for; None where its result is where its arguments are."""
    if name in ("cpu", "cuda"):
        return torch.device(name)
    for value in [*args[1:], kwargs.get("other")] if name == "to" else []:
        if isinstance(value, Tensor):
            return CARD if isinstance(value, OnCard) else HOST
    asked = [value for value in args if isinstance(value, torch.device)]
    asked += [torch.device(value) for value in args[1:] if name == "to" and isinstance(value, str)]
    asked += [torch.device(kwargs["device"])] if kwargs.get("device") is not None else []
    return asked[0] if asked else None


def _at_home(value: Any) -> Any:
    """An argument with the CPU in the place of the device."""
    if isinstance(value, torch.device):
        return HOST
    return "cpu" if isinstance(value, str) and value.startswith("cuda") else value


def _placed(value: Any, device: torch.device) -> Any:
    if not isinstance(value, Tensor):
        return value
    kind = OnCard if device.type == "cuda" else nn.Parameter if isinstance(value, nn.Parameter) else Tensor
    return value if type(value) is kind else value.as_subclass(kind)


def _tensors(values: Iterable[Any]) -> Iterator[Tensor]:
    for value in values:
        if isinstance(value, Tensor):
            yield value
        elif isinstance(value, list | tuple):
            yield from _tensors(value)
