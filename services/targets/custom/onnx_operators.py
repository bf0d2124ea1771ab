"""Defines ONNX operators (opset 13 and newer) as torch functions, so that a network has gradients.

A function takes the node's inputs, None where one is left out, and the node's attributes under their ONNX names, with
ONNX's defaults. An operator or an attribute that is not here leaves a network without gradients; its scores are
onnxruntime's. Reference: https://onnx.ai/onnx/operators/
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from services.targets.custom.onnx_windows import Ints, average_pool, conv, max_pool


def _integers(of: Tensor | Ints) -> list[int]:
    return [int(one) for one in of]


def gemm(
    a: Tensor,
    b: Tensor,
    c: Tensor | None = None,
    *,
    alpha: float = 1.0,
    beta: float = 1.0,
    transA: int = 0,
    transB: int = 0,
) -> Tensor:
    """Returns alpha · A B + beta · C."""
    found = alpha * ((a.T if transA else a) @ (b.T if transB else b))
    return found if c is None else found + beta * c


def batch_normalization(
    x: Tensor,
    scale: Tensor,
    bias: Tensor,
    mean: Tensor,
    variance: Tensor,
    *,
    epsilon: float = 1e-5,
    momentum: float = 0.9,  # noqa: ARG001 - of training
    training_mode: int = 0,
) -> Tensor:
    """Normalises by the stored mean and variance."""
    if training_mode:
        raise ValueError("BatchNormalization in training mode is not converted")
    return F.batch_norm(x, mean, variance, scale, bias, training=False, eps=epsilon)


def layer_normalization(
    x: Tensor, scale: Tensor, bias: Tensor | None = None, *, axis: int = -1, epsilon: float = 1e-5, stash_type: int = 1
) -> Tensor:
    """Normalises over the axes from `axis` on."""
    if stash_type != 1:
        raise ValueError("LayerNormalization in another type than float32 is not converted")
    return F.layer_norm(x, list(x.shape[axis % x.dim() :]), scale, bias, epsilon)


def flatten(x: Tensor, *, axis: int = 1) -> Tensor:
    """Reshapes to a matrix."""
    first = 1
    for length in x.shape[: axis if axis >= 0 else x.dim() + axis]:
        first *= length
    return x.reshape(first, -1)


def reshape(x: Tensor, shape: Tensor, *, allowzero: int = 0) -> Tensor:
    """Reshapes; a length of 0 is that of the input, -1 is what is left."""
    wanted = _integers(shape)
    if not allowzero:
        wanted = [x.shape[axis] if length == 0 else length for axis, length in enumerate(wanted)]
    return x.reshape(wanted)


def squeeze(x: Tensor, axes: Tensor | None = None) -> Tensor:
    """Removes axes of length 1."""
    return x.squeeze() if axes is None else x.squeeze(_integers(axes))


def unsqueeze(x: Tensor, axes: Tensor) -> Tensor:
    """Adds axes of length 1."""
    rank = x.dim() + len(axes)
    for axis in sorted(axis % rank for axis in _integers(axes)):
        x = x.unsqueeze(axis)
    return x


def reduce_mean(
    x: Tensor,
    given: Tensor | None = None,
    *,
    axes: Ints | None = None,
    keepdims: int = 1,
    noop_with_empty_axes: int = 0,
) -> Tensor:
    """Averages over axes, which are an attribute before opset 18 and an input from then on."""
    chosen = _integers(given) if given is not None else list(axes or ())
    if not chosen and noop_with_empty_axes:
        return x
    return x.mean(dim=chosen or list(range(x.dim())), keepdim=bool(keepdims))


def gather(x: Tensor, indices: Tensor, *, axis: int = 0) -> Tensor:
    """Picks entries of an axis."""
    axis %= x.dim()
    flat = indices.reshape(-1) % x.shape[axis]
    return x.index_select(axis, flat).reshape(*x.shape[:axis], *indices.shape, *x.shape[axis + 1 :])


def gather_nd(x: Tensor, indices: Tensor, *, batch_dims: int = 0) -> Tensor:
    """Picks entries by indices of the first axes."""
    if batch_dims:
        raise ValueError("GatherND with batch_dims is not converted")
    return x[indices.unbind(-1)]


def split(
    x: Tensor, lengths: Tensor | None = None, *, axis: int = 0, num_outputs: int | None = None
) -> tuple[Tensor, ...]:
    """Cuts an axis into parts, of given lengths or equal but for the last."""
    if lengths is None and num_outputs is None:
        raise ValueError("Split without lengths is not converted")
    total = x.shape[axis]
    parts = -(-total // (num_outputs or 1)) if lengths is None else _integers(lengths)
    found: tuple[Tensor, ...] = x.split(parts, dim=axis)  # type: ignore[no-untyped-call]
    return found


def slices(x: Tensor, starts: Tensor, ends: Tensor, axes: Tensor | None = None, steps: Tensor | None = None) -> Tensor:
    """Cuts out ranges of axes, with steps from 1."""
    first, last = _integers(starts), _integers(ends)
    along = list(range(len(first))) if axes is None else _integers(axes)
    step = [1] * len(first) if steps is None else _integers(steps)
    if min(step, default=1) < 1:
        raise ValueError("Slice with negative steps is not converted")
    cut = [slice(None)] * x.dim()
    for axis, a, b, by in zip(along, first, last, step, strict=True):
        cut[axis] = slice(a, b, by)
    return x[tuple(cut)]


def pad(
    x: Tensor, pads: Tensor, value: Tensor | None = None, axes: Tensor | None = None, *, mode: str = "constant"
) -> Tensor:
    """Pads axes with a constant."""
    if mode != "constant" or axes is not None:
        raise ValueError(f"Pad with mode {mode!r} or with axes is not converted")
    amounts = _integers(pads)
    rank = len(amounts) // 2
    pairs = [amount for axis in reversed(range(rank)) for amount in (amounts[axis], amounts[rank + axis])]
    return F.pad(x, pairs, value=0.0 if value is None else float(value))


def clip(x: Tensor, low: Tensor | None = None, high: Tensor | None = None) -> Tensor:
    """Clamps values."""
    return x if low is None and high is None else x.clamp(low, high)


def cast(x: Tensor, *, to: int, saturate: int = 1) -> Tensor:  # noqa: ARG001 - of 8-bit floats
    """Converts to another type."""
    known = {1: torch.float32, 6: torch.int32, 7: torch.int64, 9: torch.bool, 11: torch.float64}
    if to not in known:
        raise ValueError(f"Cast to the type {to} is not converted")
    return x.to(known[to])


def expand(x: Tensor, shape: Tensor) -> Tensor:
    """Broadcasts to a shape."""
    whole: tuple[int, ...] = torch.broadcast_shapes(x.shape, _integers(shape))  # type: ignore[no-untyped-call]
    return x.expand(whole)


def shape_of(x: Tensor, *, start: int = 0, end: int | None = None) -> Tensor:
    """Returns the lengths of the axes."""
    return torch.tensor(list(x.shape)[start:end], dtype=torch.int64)


OPERATORS: dict[str, Callable[..., Any]] = {
    "Add": lambda a, b: a + b,
    "AveragePool": average_pool,
    "BatchNormalization": batch_normalization,
    "Cast": cast,
    "Clip": clip,
    "Concat": lambda *of, axis: torch.cat(of, dim=axis),
    "Conv": conv,
    "Div": lambda a, b: a / b if a.is_floating_point() else torch.div(a, b, rounding_mode="trunc"),
    "Dropout": lambda x, ratio=None, training=None, *, seed=0: x,  # noqa: ARG005 - evaluation
    "Elu": lambda x, *, alpha=1.0: F.elu(x, alpha),
    "Erf": torch.erf,
    "Exp": torch.exp,
    "Expand": expand,
    "Flatten": flatten,
    "Gather": gather,
    "GatherND": gather_nd,
    "Gelu": lambda x, *, approximate="none": F.gelu(x, approximate=approximate),
    "Gemm": gemm,
    "GlobalAveragePool": lambda x: x.mean(dim=tuple(range(2, x.dim())), keepdim=True),
    "GlobalMaxPool": lambda x: x.amax(dim=tuple(range(2, x.dim())), keepdim=True),
    "HardSigmoid": lambda x, *, alpha=0.2, beta=0.5: (alpha * x + beta).clamp(0.0, 1.0),
    "HardSwish": F.hardswish,
    "Identity": lambda x: x,
    "LayerNormalization": layer_normalization,
    "LeakyRelu": lambda x, *, alpha=0.01: F.leaky_relu(x, alpha),
    "Log": torch.log,
    "LogSoftmax": lambda x, *, axis=-1: F.log_softmax(x, dim=axis),
    "MatMul": torch.matmul,
    "MaxPool": max_pool,
    "Mul": lambda a, b: a * b,
    "Neg": torch.neg,
    "Pad": pad,
    "Pow": torch.pow,
    "ReduceMean": reduce_mean,
    "Relu": F.relu,
    "Reshape": reshape,
    "Shape": shape_of,
    "Sigmoid": torch.sigmoid,
    "Slice": slices,
    "Softmax": lambda x, *, axis=-1: F.softmax(x, dim=axis),
    "Split": split,
    "Sqrt": torch.sqrt,
    "Squeeze": squeeze,
    "Sub": lambda a, b: a - b,
    "Sum": lambda *of: sum(of[1:], start=of[0]),
    "Tanh": torch.tanh,
    "Transpose": lambda x, *, perm=None: x.permute(perm if perm is not None else tuple(reversed(range(x.dim())))),
    "Unsqueeze": unsqueeze,
}
