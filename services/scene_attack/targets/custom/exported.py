"""Reads a program that `torch.export.save` wrote (.pt2), without unpickling anything, and runs it as a list of steps.

`torch.export.load` must not be used on files from outside. In torch 2.13 it unpickles the example inputs, without
restrictions if the restricted way fails; unpickles weights and constants that say so; looks up operators as attributes
of `torch`, which has `torch.os.system`; evaluates shape expressions; compiles guards; and loads machine code. This
module reads the archive itself: the graph is JSON, the weights are plain bytes. The example inputs are never read.
"""

import json
import operator
import zipfile
from collections.abc import Callable, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.fx import Graph, Interpreter, Node

from scene_attack.errors import Unreadable


class _Steps(Interpreter):
    """Runs a graph operation by operation. A failure names the operation, and is a RuntimeError."""

    def run_node(self, n: Node) -> Any:
        """Returns the result of a node."""
        try:
            return super().run_node(n)
        except (RuntimeError, TypeError, ValueError, IndexError) as error:
            raise RuntimeError(f"{n.name}: {error}") from error


class GraphNetwork(nn.Module):
    """A frozen network of the operations of a graph. It maps its one input to its one output, both tensors.

    The graph is interpreted: `torch.fx.GraphModule` would write Python code with names and texts of the file in it.
    """

    def __init__(self, graph: Graph, weights: Sequence[Tensor]) -> None:
        """The graph calls its weights `weight_0`, `weight_1`, …"""
        super().__init__()
        self._graph = graph
        for index, value in enumerate(weights):
            self.register_buffer(f"weight_{index}", value)

    def forward(self, x: Tensor) -> Tensor:
        """Returns the output of the input x. Raises RuntimeError, naming the operation, for one that fails."""
        steps = _Steps(self, graph=self._graph)  # a new one, as it keeps its results
        steps.extra_traceback = False
        result: Tensor = steps.run(x)
        return result


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


MAX_BYTES = 8 * 2**30
"""Largest sum of the archive's members."""
_MAJOR = 8
"""Major version of the schema that this module reads; torch raises it with a change that breaks readers."""
_DTYPES = {
    1: torch.uint8, 2: torch.int8, 3: torch.int16, 4: torch.int32, 5: torch.int64, 6: torch.float16, 7: torch.float32,
    8: torch.float64, 12: torch.bool, 13: torch.bfloat16,
}  # fmt: skip
_FORMATS = {
    1: torch.contiguous_format, 2: torch.channels_last, 3: torch.channels_last_3d, 4: torch.preserve_format
}  # fmt: skip
_STRIDED = 7
_PLAIN = ("as_int", "as_ints", "as_bool", "as_bools", "as_string")
_POSITIONAL, _KEYWORD = 1, 2
_NAMES = """
conv1d conv2d conv3d convolution conv_transpose2d linear addmm mm bmm matmul baddbmm einsum addbmm mv dot outer
batch_norm _native_batch_norm_legit_no_training layer_norm native_layer_norm group_norm native_group_norm
instance_norm rms_norm
relu relu_ relu6 relu6_ leaky_relu leaky_relu_ elu elu_ selu selu_ celu gelu silu silu_ mish hardtanh hardtanh_
hardswish hardswish_ hardsigmoid hardsigmoid_ sigmoid sigmoid_ tanh tanh_ softplus softmax log_softmax _softmax
_log_softmax logsumexp prelu glu threshold threshold_ log_sigmoid
max_pool2d max_pool2d_with_indices avg_pool2d adaptive_avg_pool2d _adaptive_avg_pool2d adaptive_max_pool2d
avg_pool1d adaptive_avg_pool1d max_pool1d
dropout dropout_ feature_dropout feature_dropout_ alpha_dropout
upsample_nearest2d upsample_bilinear2d upsample_bicubic2d _upsample_bilinear2d_aa _upsample_bicubic2d_aa
grid_sampler affine_grid_generator
scaled_dot_product_attention
add add_ sub sub_ rsub mul mul_ div div_ neg abs pow sqrt rsqrt exp log log2 log1p expm1 sin cos erf clamp clamp_
clamp_min clamp_max minimum maximum where sign floor ceil round trunc reciprocal square fmod remainder lerp addcmul
eq ne lt le gt ge logical_and logical_or logical_not masked_fill masked_fill_
mean sum amax amin max min argmax argmin prod var var_mean std norm linalg_vector_norm cumsum topk sort any all
view reshape flatten unflatten permute transpose t squeeze unsqueeze expand expand_as repeat repeat_interleave cat
concat stack split split_with_sizes chunk unbind select slice narrow index index_select gather pad constant_pad_nd
reflection_pad2d replication_pad2d roll flip contiguous clone detach detach_ to _to_copy type_as alias view_as
reshape_as unfold im2col pixel_shuffle pixel_unshuffle channel_shuffle native_channel_shuffle movedim embedding
lift_fresh_copy numpy_T swapaxes swapdims meshgrid broadcast_tensors
zeros ones full arange linspace zeros_like ones_like full_like scalar_tensor new_zeros new_ones new_full eye tril
triu one_hot sym_size sym_numel _assert_tensor_metadata _assert_scalar
"""
"""Operators that a program may use: those of inference that read and write nothing but tensors. A program is data from
outside. Operators that read files, run code, or leave memory uninitialised are not here.
"""
_ATEN = frozenset(_NAMES.split())
_SHAPES: dict[str, Callable[..., Any]] = {
    name: getattr(operator, name)
    for name in ("add", "sub", "mul", "floordiv", "truediv", "mod", "neg", "eq", "ne", "lt", "le", "gt", "ge")
}
"""Arithmetic on lengths of a shape."""


def read(path: Path, size: tuple[int, int]) -> nn.Module:
    """Returns the network of a .pt2 file: inputs [B, 3, *size] to the program's output.

    Raises Unreadable for a file that is no such program, needs unpickling, holds compiled code, or uses an operator
    that is not allowed. A program that was exported for a fixed number of images is run in portions of that number.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = _members(archive)
            program = _document(archive, members, "models/model.json")
            weights = _tensors(archive, members, "weights", "weight_")
            weights |= _tensors(archive, members, "constants", "tensor_")
        return _network(program, weights, size)
    except zipfile.BadZipFile as error:
        raise Unreadable(f"it is no archive of torch.export.save: {error}") from error
    except (KeyError, IndexError, TypeError, AttributeError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise Unreadable(f"its program is damaged: {type(error).__name__}: {error}") from error


def _members(archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """The archive's members by name, without the folder that all are in."""
    members = {info.filename.partition("/")[2]: info for info in archive.infolist()}
    if any(info.compress_type != zipfile.ZIP_STORED for info in members.values()):
        raise Unreadable("its members are compressed, which torch.export.save never does")
    if sum(info.file_size for info in members.values()) > MAX_BYTES:
        raise Unreadable(f"it is larger than {MAX_BYTES // 2**30} GiB")
    if "archive_format" not in members or archive.read(members["archive_format"]) != b"pt2":
        raise Unreadable(
            "it was not written by torch.export.save (torch 2.8 or newer); "
            "neither TorchScript nor what torch.save wrote is read"
        )
    if any(name.startswith("data/aotinductor/") for name in members):
        raise Unreadable("it holds compiled machine code, which is never loaded; save the exported program instead")
    return members


def _document(archive: zipfile.ZipFile, members: Mapping[str, zipfile.ZipInfo], name: str) -> dict[str, Any]:
    if name not in members:
        raise Unreadable(f"it has no {name}; write it with torch.export.save")
    document: dict[str, Any] = json.loads(archive.read(members[name]))
    return document


def _tensors(
    archive: zipfile.ZipFile, members: Mapping[str, zipfile.ZipInfo], kind: str, prefix: str
) -> dict[str, Tensor]:
    tensors: dict[str, Tensor] = {}
    for name, meta in _document(archive, members, f"data/{kind}/model_{kind}_config.json")["config"].items():
        file = meta["path_name"]
        if meta["use_pickle"] or not file.startswith(prefix):
            raise Unreadable(f"its tensor {name!r:.80} is stored as a pickle, which can run any code and is never read")
        tensors[name] = _tensor(archive.read(members[f"data/{kind}/{file}"]), meta["tensor_meta"])
    return tensors


def _tensor(data: bytes, meta: Mapping[str, Any]) -> Tensor:
    dtype = _dtype(meta["dtype"])
    shape = [length["as_int"] for length in meta["sizes"]]
    if not prod(shape):
        return torch.empty(shape, dtype=dtype)
    stride = [length["as_int"] for length in meta["strides"]]
    try:
        flat = torch.frombuffer(bytearray(data), dtype=dtype)
        return flat.as_strided(shape, stride, meta["storage_offset"]["as_int"]).clone()
    except (RuntimeError, ValueError) as error:
        raise Unreadable(f"a weight of shape {shape} does not fit its {len(data)} bytes") from error


def _dtype(number: int) -> torch.dtype:
    if number not in _DTYPES:
        raise Unreadable(f"it uses the data type {number} of torch's schema, which is not read here")
    return _DTYPES[number]


def _network(program: Mapping[str, Any], weights: Mapping[str, Tensor], size: tuple[int, int]) -> nn.Module:
    major = program["schema_version"]["major"]
    if major != _MAJOR:
        raise Unreadable(f"its schema has the version {major}, not {_MAJOR}; export it with torch 2.8 or newer")
    module = program["graph_module"]
    graph, signature = module["graph"], module["signature"]
    bound, source = _inputs(signature["input_specs"], weights)
    made = Graph()
    x = made.placeholder("x")
    values = _Values({source: x})
    device = made.call_function(getattr, (x, "device"))  # in place of the device on which the file was made
    values |= {name: made.get_attr(f"weight_{index}") for index, name in enumerate(bound)}
    for index, node in enumerate(graph["nodes"]):
        _add_operation(made, f"node_{index}", node, values, device)
    made.output(values[_result(signature["output_specs"])])
    for result in reversed(made.nodes):
        if result.target is operator.getitem and not result.users:  # it would be kept to the end
            made.erase_node(result)
    network = GraphNetwork(made, list(bound.values()))
    about = graph["tensor_values"][source]
    count = check_input([length.get("as_int") for length in about["sizes"]], size)
    if not _dtype(about["dtype"]).is_floating_point:
        raise Unreadable("its input is not floating-point; let it take images as normalised values")
    return network if count is None else FixedBatch(network, count)


def _inputs(specs: list[dict[str, Any]], weights: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], str]:
    """The weights by their names in the graph, and the name of the input."""
    bound, inputs = {}, []
    for spec in specs:
        ((kind, about),) = spec.items()
        if kind == "user_input":
            inputs.append(about["arg"])
        elif kind in ("parameter", "buffer", "tensor_constant"):
            name = about[f"{kind}_name"]
            if name not in weights:
                raise Unreadable(f"its weight {name!r:.80} is missing")
            bound[about["arg"]["name"]] = weights[name]
        else:
            raise Unreadable(f"its input {kind!r:.40} is not supported; the program takes images alone")
    if len(inputs) != 1 or "as_tensor" not in inputs[0]:
        raise Unreadable(f"it has {len(inputs)} inputs; one is due, images [B, 3, height, width]")
    return bound, inputs[0]["as_tensor"]["name"]


def _result(specs: list[dict[str, Any]]) -> str:
    if len(specs) != 1 or "user_output" not in specs[0] or "as_tensor" not in specs[0]["user_output"]["arg"]:
        kinds = ", ".join(kind for spec in specs for kind in spec)
        raise Unreadable(f"it returns {len(specs)} values ({kinds}); one tensor of scores [B, K] is due")
    name: str = specs[0]["user_output"]["arg"]["as_tensor"]["name"]
    return name


class _Values(dict[str, Node]):
    """The results of a program by name, in the order in which they are made."""

    def __missing__(self, name: str) -> Node:
        raise Unreadable(f"it needs {name!r:.80}, which nothing before it makes")


def _add_operation(graph: Graph, name: str, node: Mapping[str, Any], values: _Values, device: Node) -> None:
    target = node["target"]
    inputs = [(argument["kind"], argument["name"], argument["arg"]) for argument in node["inputs"]]
    if any(kind not in (_POSITIONAL, _KEYWORD) for kind, _, _ in inputs):
        raise Unreadable("it was exported by an old version of torch; export it with torch 2.8 or newer")
    positional = tuple(_argument(argument, values, device) for kind, _, argument in inputs if kind == _POSITIONAL)
    keywords = {key: _argument(argument, values, device) for kind, key, argument in inputs if kind == _KEYWORD}
    first = positional[0] if positional else None
    if changes_its_input(target) and isinstance(first, Node) and first.op == "get_attr":
        raise Unreadable(f"{target} changes its weight; export the network in evaluation mode")
    label = f"{name}_{target.removeprefix('torch.ops.')}"
    made = graph.create_node("call_function", operator_of(target), positional, keywords, label)
    outputs = node["outputs"]
    if len(outputs) == 1 and "as_tensors" not in outputs[0]:
        values[_output_names(outputs[0])[0]] = made
        return
    for place, result in enumerate(name for output in outputs for name in _output_names(output)):
        values[result] = graph.call_function(operator.getitem, (made, place))


def _output_names(output: Mapping[str, Any]) -> list[str]:
    """The names of the results that an output stands for: several where it is a list of tensors."""
    ((kind, value),) = output.items()
    if kind == "as_tensors":
        return [tensor["name"] for tensor in value]
    return [value["as_name"] if "as_name" in value else value["name"]]


def _argument(argument: Mapping[str, Any], values: _Values, device: Node) -> Any:
    """The value of an argument in the schema's form, a dictionary with one key that says its kind."""
    ((kind, value),) = argument.items()
    if kind in _PLAIN:
        return value
    if kind == "as_none":
        return None
    if kind == "as_float":
        return float(value)  # infinities are written as strings
    if kind == "as_floats":
        return [float(element) for element in value]
    if kind in ("as_tensor", "as_sym_int", "as_sym_float", "as_sym_bool", "as_optional_tensor"):
        return _named(value, values)
    if kind in ("as_tensors", "as_sym_ints", "as_optional_tensors"):
        return [_named(element, values) for element in value]
    if kind == "as_scalar_type":
        return _dtype(value)
    if kind == "as_memory_format" and value in _FORMATS:
        return _FORMATS[value]
    if kind == "as_layout" and value == _STRIDED:
        return torch.strided
    if kind == "as_device":
        return device
    raise Unreadable(f"it has an argument of the kind {kind!r:.40}, which is not supported")


def _named(value: Mapping[str, Any], values: _Values) -> Any:
    """A tensor or a length: {"name": …}, {"as_name": …}, {"as_int": …}, {"as_tensor": {"name": …}} or none."""
    for key in ("name", "as_name"):
        if key in value:
            return values[value[key]]
    if "as_tensor" in value:
        return values[value["as_tensor"]["name"]]
    if "as_none" in value:
        return None
    ((_, number),) = value.items()
    return number


def operator_of(target: str) -> Callable[..., Any]:
    """Returns the operator of a name such as "torch.ops.aten.conv2d.default". Raises Unreadable, naming it, if it is
    none that a program may use.
    """
    if target.startswith("_operator.") and target.removeprefix("_operator.") in _SHAPES:
        return _SHAPES[target.removeprefix("_operator.")]
    parts = target.split(".")
    if len(parts) == 5 and parts[:3] == ["torch", "ops", "aten"] and parts[3] in _ATEN and "out" not in parts[4]:
        packet = getattr(torch.ops.aten, parts[3], None)
        if packet is not None and parts[4] in packet.overloads():
            overload: Callable[..., Any] = getattr(packet, parts[4])
            return overload
    raise Unreadable(f"it uses the operator {target!r:.120}, which is not among those that a .pt2 program may use here")


def changes_its_input(target: str) -> bool:
    """Whether the operator writes its result over its first input."""
    return target.split(".")[3:4] != [] and target.split(".")[3].endswith("_")
