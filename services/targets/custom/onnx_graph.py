"""Converts an ONNX network to torch, so that it has gradients, where every operator is among `onnx_operators`."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from services.targets.custom.graph import GraphNetwork, Step, Unreadable, Value
from services.targets.custom.onnx_operators import OPERATORS

OLDEST_OPSET = 13


def convert(model: onnx.ModelProto) -> GraphNetwork:
    """Returns the network in torch, frozen. Raises Unreadable, which names what is not converted."""
    graph = model.graph
    opset = max((one.version for one in model.opset_import if one.domain in ("", "ai.onnx")), default=0)
    if opset < OLDEST_OPSET:
        raise Unreadable(f"opset {opset} is not converted, only {OLDEST_OPSET} and newer")
    weights = {one.name: _tensor(one) for one in graph.initializer}
    steps: list[Step] = []
    layers: dict[str, nn.Module] = {}
    for index, node in enumerate(graph.node):
        label = f"node {index} ({node.op_type})"
        attributes = {one.name: _attribute(one) for one in node.attribute}
        if node.op_type == "Constant" and not node.domain:
            weights[node.output[0]] = _constant(attributes, label)
            continue
        if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
            raise Unreadable(f"{label} is not converted")
        inputs = tuple(Value(name) if name else None for name in node.input)
        layer = _convolution(node, attributes, weights) if node.op_type == "Conv" else None
        if layer is not None:
            # a layer of its own, whose weights can be packed
            layers[f"convolution_{index}"] = layer
            steps.append(Step(label, f"convolution_{index}", inputs[:1], (node.output[0],)))
        else:
            run = partial(OPERATORS[node.op_type], **attributes)
            # of another operator only the first output is converted: masks and indices are not
            outputs = tuple(node.output) if node.op_type == "Split" else (node.output[0],)
            steps.append(Step(label, run, inputs, outputs))
    source = next(one.name for one in graph.input if one.name not in weights)
    return GraphNetwork(source, graph.output[0].name, steps, weights, layers)


def _tensor(given: onnx.TensorProto) -> Tensor:
    return torch.from_numpy(numpy_helper.to_array(given).copy())


def _attribute(given: onnx.AttributeProto) -> Any:
    value = onnx.helper.get_attribute_value(given)
    return value.decode() if isinstance(value, bytes) else value


def _constant(attributes: Mapping[str, Any], label: str) -> Tensor:
    ((name, value),) = attributes.items()
    if name == "value":
        return _tensor(value)
    if name in ("value_int", "value_ints"):
        return torch.tensor(value, dtype=torch.int64)
    if name in ("value_float", "value_floats"):
        return torch.tensor(value, dtype=torch.float32)
    raise Unreadable(f"{label} with {name} is not converted")


def _convolution(
    node: onnx.NodeProto, attributes: Mapping[str, Any], weights: Mapping[str, Tensor]
) -> nn.Conv2d | None:
    """The node as a layer; None where its weights are computed, or its padding is none that `nn.Conv2d` has."""
    given = [weights.get(name) for name in node.input[1:] if name]
    weight = given[0] if given else None
    pads = list(attributes.get("pads", (0, 0, 0, 0)))
    plain = attributes.get("auto_pad", "NOTSET") in ("NOTSET", "VALID") and pads[:2] == pads[2:]
    if weight is None or weight.dim() != 4 or not plain or any(one is None for one in given):
        return None
    group = attributes.get("group", 1)
    layer = nn.Conv2d(
        weight.shape[1] * group,
        weight.shape[0],
        (weight.shape[2], weight.shape[3]),
        stride=tuple(attributes.get("strides", (1, 1))),
        padding=tuple(pads[:2]),
        dilation=tuple(attributes.get("dilations", (1, 1))),
        groups=group,
        bias=len(given) == 2,
    ).requires_grad_(False)
    layer.weight.data = weight
    if layer.bias is not None and given[1] is not None:
        layer.bias.data = given[1]
    return layer
