"""Reads an .onnx file: scores are computed by onnxruntime, on the CPU. They have no gradients."""

from collections.abc import Iterator
from pathlib import Path

import onnx
import onnxruntime
import torch
from google.protobuf.message import DecodeError, Message
from torch import Tensor, nn

from scene_attack.errors import Unreadable
from scene_attack.targets.custom.exported import FixedBatch, check_input

SCORES_ONLY = "an ONNX file gives scores only; for gradients save the network by torch.export.save, as model.pt2"
_ERRORS_ONLY = 3


class OnnxNetwork(nn.Module):
    """Scores of onnxruntime, without gradients."""

    def __init__(self, session: onnxruntime.InferenceSession) -> None:
        super().__init__()
        self._session = session
        (source,), (result,) = session.get_inputs(), session.get_outputs()
        self._input, self._output = source.name, result.name

    def forward(self, x: Tensor) -> Tensor:
        """Maps inputs [B, 3, h, w] to scores."""
        values = x.detach().to("cpu", torch.float32).contiguous().numpy()
        (scores,) = self._session.run([self._output], {self._input: values})
        return torch.from_numpy(scores).to(x.device)


def read(path: Path, size: tuple[int, int]) -> nn.Module:
    """Returns the network of an .onnx file.

    Raises Unreadable for a file that is no ONNX model, refers to other files, or has other than one input and one
    output.
    """
    data = path.read_bytes()
    try:
        model = onnx.load_model_from_string(data)
    except DecodeError as error:
        raise Unreadable("it is no ONNX model") from error
    if any(tensor.data_location == onnx.TensorProto.EXTERNAL for tensor in _tensors(model)):
        raise Unreadable("its weights are in another file; save it as one file, without external data")
    session = _session(data)
    count = _count(session, size)
    return OnnxNetwork(session) if count is None else FixedBatch(OnnxNetwork(session), count)


def _tensors(message: Message) -> Iterator[onnx.TensorProto]:
    """All tensors of a model: initialisers, constants of nodes, and those of subgraphs and functions."""
    if isinstance(message, onnx.TensorProto):
        yield message
        return
    for field, value in message.ListFields():
        if field.type == field.TYPE_MESSAGE:
            for item in (value,) if isinstance(value, Message) else value:
                yield from _tensors(item)


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
    inputs, results = session.get_inputs(), session.get_outputs()
    if len(inputs) != 1:
        names = ", ".join(value.name for value in inputs)
        raise Unreadable(f"it has {len(inputs)} inputs ({names}); one is due, images [B, 3, height, width]")
    if len(results) != 1:
        names = ", ".join(value.name for value in results)
        raise Unreadable(f"it has {len(results)} outputs ({names}); one is due, scores [B, K]")
    for value in (*inputs, *results):
        if value.type != "tensor(float)":
            raise Unreadable(f"{value.name!r} is {value.type}; tensor(float) is due, which is float32")
    return check_input([length if isinstance(length, int) else None for length in inputs[0].shape], size)
