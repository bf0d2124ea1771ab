"""Reads an .onnx file: scores are computed by onnxruntime, gradients by the network converted to torch.

Both are on the CPU. The converted network is compared with onnxruntime when it is loaded; where an operator is not
converted or the scores differ, the network has scores only.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import onnx
import onnxruntime
import torch
from google.protobuf.message import DecodeError, Message
from torch import Tensor, nn

from services.device import device
from services.targets.custom.graph import FixedBatch, Unreadable, check_input
from services.targets.custom.onnx_graph import convert
from services.targets.packing import pack, to_channels_last

TOLERANCE = 1e-4
"""Largest difference between a score in torch and in onnxruntime, relative to the largest score or 1."""
_ERRORS_ONLY = 3
_TRIED = 2


class OnnxNetwork(nn.Module):
    """Scores of onnxruntime, and where a gradient is asked for those of the converted network."""

    def __init__(self, session: onnxruntime.InferenceSession, converted: nn.Module | None) -> None:
        super().__init__()
        self._session, self.converted = session, converted
        (given,), (result,) = session.get_inputs(), session.get_outputs()
        self._input, self._output = given.name, result.name

    def forward(self, x: Tensor) -> Tensor:
        """Maps inputs [B, 3, h, w] to scores."""
        if self.converted is not None and torch.is_grad_enabled() and x.requires_grad:
            found: Tensor = self.converted(x)
            return found
        values = x.detach().to("cpu", torch.float32).contiguous().numpy()
        (scores,) = self._session.run([self._output], {self._input: values})
        return torch.from_numpy(scores).to(x.device)


def read(path: Path, size: tuple[int, int], dtype: torch.dtype) -> tuple[nn.Module, str | None]:
    """Returns the network of an .onnx file, and the reason for which it has no gradients, None if it has.

    Raises Unreadable for what is no ONNX, refers to other files, or has other than one input and one output.
    """
    data = path.read_bytes()
    try:
        model = onnx.load_model_from_string(data)
    except DecodeError as error:
        raise Unreadable("it is no ONNX model") from error
    if any(one.data_location == onnx.TensorProto.EXTERNAL for one in _tensors(model)):
        raise Unreadable("its weights are in another file; save it as one file, without external data")
    session = _session(data)
    count = _count(session, size)
    try:
        converted: nn.Module | None = _converted(model, session, size, count, dtype)
        reason = None
    except (Unreadable, RuntimeError, ValueError) as error:
        converted, reason = None, str(error)
    network: nn.Module = OnnxNetwork(session, converted)
    return (network if count is None else FixedBatch(network, count)), reason


def _tensors(message: Message) -> Iterator[onnx.TensorProto]:
    """All tensors of a model: initialisers, constants of nodes, and those of subgraphs and functions."""
    if isinstance(message, onnx.TensorProto):
        yield message
        return
    for field, value in message.ListFields():
        if field.type == field.TYPE_MESSAGE:
            for one in (value,) if isinstance(value, Message) else value:
                yield from _tensors(one)


def _session(data: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = torch.get_num_threads()
    options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = _ERRORS_ONLY
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # torch's threads need the cores
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its classes of errors have no public base
        raise Unreadable(f"onnxruntime refuses it: {' '.join(str(error).split())[:300]}") from error


def _count(session: onnxruntime.InferenceSession, size: tuple[int, int]) -> int | None:
    """The number of images that the model is fixed to, None for any number."""
    given, results = session.get_inputs(), session.get_outputs()
    if len(given) != 1:
        names = ", ".join(one.name for one in given)
        raise Unreadable(f"it has {len(given)} inputs ({names}); one is due, images [B, 3, height, width]")
    if len(results) != 1:
        names = ", ".join(one.name for one in results)
        raise Unreadable(f"it has {len(results)} outputs ({names}); one is due, scores [B, K]")
    for one in (*given, *results):
        if one.type != "tensor(float)":
            raise Unreadable(f"{one.name!r} is {one.type}; tensor(float) is due, which is float32")
    return check_input([one if isinstance(one, int) else None for one in given[0].shape], size)


def _converted(
    model: onnx.ModelProto,
    session: onnxruntime.InferenceSession,
    size: tuple[int, int],
    count: int | None,
    dtype: torch.dtype,
) -> nn.Module:
    """The network in torch. Raises Unreadable if its scores are not those of onnxruntime."""
    network = convert(model).to(device(), dtype).eval().requires_grad_(False)
    if device().type == "cpu" and dtype == torch.float32 and count in (None, 1):
        to_channels_last(network)
        pack(network, size)
    tried = torch.randn((count or _TRIED, 3, *size), generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        wanted = OnnxNetwork(session, None)(tried)
        found: Any = network(tried.to(device(), dtype)).cpu()
    if found.shape != wanted.shape:
        raise Unreadable(f"its scores in torch are {list(found.shape)}, in onnxruntime {list(wanted.shape)}")
    difference, largest = float((found - wanted).abs().max()), max(1.0, float(wanted.abs().max()))
    if not difference <= TOLERANCE * largest:
        raise Unreadable(f"its scores in torch differ from those of onnxruntime by {difference:.1e}")
    return network
