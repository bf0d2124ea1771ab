"""Each converted operator against onnxruntime, and networks that are not converted."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from services.targets.custom import onnx_file, onnx_operators
from services.targets.custom.graph import Unreadable
from services.targets.custom.onnx_graph import convert
from services.targets.custom.onnx_operators import OPERATORS

OPSET = 20
RANDOM = np.random.default_rng(1)
IMAGE = [2, 4, 9, 11]
SIZE = (8, 8)


def values(*shape: int) -> Any:
    return RANDOM.normal(size=shape).astype(np.float32)


def integers(*of: int) -> Any:
    return np.array(of, dtype=np.int64)


Case = tuple[str, Sequence[int], list[Any], dict[str, Any]]
CASES: list[Case] = [
    ("Add", IMAGE, [values(4, 1, 1)], {}),
    ("AveragePool", IMAGE, [], {"kernel_shape": [3, 2], "strides": [2, 1]}),
    ("AveragePool", IMAGE, [], {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1]}),
    ("AveragePool", IMAGE, [], {"kernel_shape": [3, 3], "pads": [1, 1, 1, 1], "count_include_pad": 1}),
    ("AveragePool", IMAGE, [], {"kernel_shape": [2, 2], "strides": [2, 2], "ceil_mode": 1}),
    ("BatchNormalization", IMAGE, [values(4), values(4), values(4), abs(values(4)) + 0.5], {"epsilon": 1e-3}),
    ("Clip", IMAGE, [np.float32(-0.5), np.float32(0.7)], {}),
    ("Clip", IMAGE, [np.float32(0.0)], {}),
    ("Concat", IMAGE, [values(2, 3, 9, 11)], {"axis": 1}),
    ("Conv", IMAGE, [values(6, 4, 3, 3), values(6)], {"pads": [1, 1, 1, 1], "strides": [2, 2]}),
    ("Conv", IMAGE, [values(6, 2, 3, 2)], {"group": 2, "dilations": [2, 1]}),
    ("Conv", IMAGE, [values(6, 4, 3, 3)], {"pads": [0, 1, 2, 1]}),
    ("Conv", IMAGE, [values(6, 4, 3, 4)], {"auto_pad": "SAME_UPPER", "strides": [2, 2]}),
    ("Conv", IMAGE, [values(6, 4, 3, 4)], {"auto_pad": "SAME_LOWER", "strides": [2, 3]}),
    ("Conv", IMAGE, [values(6, 4, 3, 4)], {"auto_pad": "VALID"}),
    ("Div", IMAGE, [values(11) + 5], {}),
    ("Dropout", IMAGE, [], {}),
    ("Elu", IMAGE, [], {"alpha": 0.7}),
    ("Erf", IMAGE, [], {}),
    ("Exp", IMAGE, [], {}),
    ("Expand", [1, 4, 1], [integers(2, 1, 3)], {}),
    ("Flatten", IMAGE, [], {"axis": 2}),
    ("Flatten", IMAGE, [], {"axis": -1}),
    ("Flatten", IMAGE, [], {"axis": 0}),
    ("Gather", IMAGE, [np.array([[0, -1], [2, 1]], dtype=np.int64)], {"axis": 1}),
    ("GatherND", IMAGE, [np.array([[[0, 1], [1, 3]]], dtype=np.int64)], {}),
    ("Gelu", IMAGE, [], {"approximate": "tanh"}),
    ("Gemm", [3, 5], [values(4, 5), values(4)], {"alpha": 0.5, "beta": 2.0, "transB": 1}),
    ("Gemm", [5, 3], [values(5, 4)], {"transA": 1}),
    ("GlobalAveragePool", IMAGE, [], {}),
    ("GlobalMaxPool", IMAGE, [], {}),
    ("HardSigmoid", IMAGE, [], {"alpha": 0.3}),
    ("HardSwish", IMAGE, [], {}),
    ("Identity", IMAGE, [], {}),
    ("LayerNormalization", IMAGE, [values(9, 11), values(9, 11)], {"axis": 2, "epsilon": 1e-3}),
    ("LeakyRelu", IMAGE, [], {"alpha": 0.2}),
    ("LogSoftmax", IMAGE, [], {"axis": 1}),
    ("MatMul", [2, 5, 3], [values(3, 4)], {}),
    ("MaxPool", IMAGE, [], {"kernel_shape": [3, 3], "strides": [2, 2], "pads": [1, 1, 1, 1]}),
    ("MaxPool", IMAGE, [], {"kernel_shape": [3, 2], "pads": [0, 0, 2, 1], "dilations": [2, 1]}),
    ("MaxPool", IMAGE, [], {"kernel_shape": [3, 3], "strides": [2, 2], "ceil_mode": 1}),
    ("MaxPool", IMAGE, [], {"kernel_shape": [3, 3], "strides": [2, 2], "auto_pad": "SAME_UPPER"}),
    ("Mul", IMAGE, [values(1)], {}),
    ("Neg", IMAGE, [], {}),
    ("Pad", IMAGE, [integers(0, 0, 1, 2, 0, 1, 3, 0), np.float32(0.5)], {}),
    ("Pow", IMAGE, [np.float32(2.0)], {}),
    ("ReduceMean", IMAGE, [integers(2, -1)], {"keepdims": 0}),
    ("ReduceMean", IMAGE, [], {}),
    ("Relu", IMAGE, [], {}),
    ("Reshape", IMAGE, [integers(0, 2, -1, 11)], {}),
    ("Shape", IMAGE, [], {"start": 1}),
    ("Sigmoid", IMAGE, [], {}),
    ("Slice", IMAGE, [integers(1, 0), integers(-1, 99), integers(2, 3), integers(1, 2)], {}),
    ("Softmax", IMAGE, [], {"axis": 1}),
    ("Split", IMAGE, [integers(3, 6)], {"axis": 2}),
    ("Split", IMAGE, [], {"axis": 3, "num_outputs": 3}),
    ("Squeeze", [2, 1, 3, 1], [integers(1, -1)], {}),
    ("Sub", IMAGE, [values(11)], {}),
    ("Sum", IMAGE, [values(11), values(9, 1)], {}),
    ("Tanh", IMAGE, [], {}),
    ("Transpose", IMAGE, [], {"perm": [0, 2, 3, 1]}),
    ("Transpose", IMAGE, [], {}),
    ("Unsqueeze", IMAGE, [integers(0, -1)], {}),
]  # fmt: skip
POSITIVE = {"Log", "Sqrt"}
CASES += [(name, IMAGE, [], {}) for name in sorted(POSITIVE)]
CASES += [("Cast", IMAGE, [], {"to": int(TensorProto.INT64)})]


def model(kind: str, shape: Sequence[Any], more: list[Any], attributes: dict[str, Any]) -> onnx.ModelProto:
    names = [f"w{index}" for index in range(len(more))]
    more_outputs = [f"y{index}" for index in range(1, 3 if "num_outputs" in attributes else 2)]
    outputs = ["y", *more_outputs] if kind == "Split" else ["y"]
    node = helper.make_node(kind, ["x", *names], outputs, **attributes)
    return in_model([node], shape, [numpy_helper.from_array(v, n) for n, v in zip(names, more, strict=True)])


def in_model(nodes: list[onnx.NodeProto], shape: Sequence[Any], weights: Sequence[Any] = (), opset: int = OPSET) -> Any:
    x = helper.make_tensor_value_info("x", TensorProto.FLOAT, shape)
    y = onnx.ValueInfoProto(name="y")
    graph = helper.make_graph(nodes, "g", [x], [y], list(weights))
    found = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=9)
    return onnx.shape_inference.infer_shapes(found)


def run(made: onnx.ModelProto, x: Any) -> Any:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(made.SerializeToString(), options, providers=["CPUExecutionProvider"])
    return session.run(None, {"x": x})[0]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case[0]} {case[3]}")
def test_an_operator_computes_what_onnxruntime_does(case: Case) -> None:
    kind, shape, more, attributes = case
    made = model(kind, shape, more, attributes)
    x = values(*shape)
    x = abs(x) if kind in POSITIVE else x
    wanted = run(made, x)
    found = convert(made)(torch.from_numpy(x)).numpy()
    assert found.shape == wanted.shape
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=2e-6)


def test_every_operator_has_a_case() -> None:
    assert {case[0] for case in CASES} == set(OPERATORS)


def means(kind: str, opset: int = OPSET, **attributes: Any) -> Any:
    """A network of one operator on the means of the channels."""
    nodes = [
        helper.make_node("GlobalAveragePool", ["x"], ["m"]),
        helper.make_node("Flatten", ["m"], ["f"]),
        helper.make_node(kind, ["f"], ["y"], **attributes),
    ]
    return in_model(nodes, ("B", 3, *SIZE), opset=opset)


def read(made: onnx.ModelProto, root: Path) -> tuple[torch.nn.Module, str | None]:
    onnx.save(made, root / "model.onnx")
    return onnx_file.read(root / "model.onnx", SIZE, torch.float32)


@torch.no_grad()
def test_an_operator_that_is_not_converted_leaves_scores(tmp_path: Path) -> None:
    network, reason = read(means("Celu"), tmp_path)
    assert reason == "node 2 (Celu) is not converted"
    x = torch.randn(3, 3, *SIZE)
    torch.testing.assert_close(network(x), torch.nn.functional.celu(x.mean(dim=(2, 3))))
    assert read(means("Relu", 11), tmp_path)[1] == "opset 11 is not converted, only 13 and newer"


def test_a_conversion_that_computes_something_else_is_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert read(means("Sigmoid"), tmp_path)[1] is None
    monkeypatch.setitem(onnx_operators.OPERATORS, "Sigmoid", lambda x: torch.sigmoid(x) + 3e-4)
    assert "differ from those of onnxruntime by 3.0e-04" in str(read(means("Sigmoid"), tmp_path)[1])


def test_weights_in_another_file_are_refused(tmp_path: Path) -> None:
    made = model("Conv", ("B", 3, *SIZE), [values(40, 3, 8, 8)], {})
    onnx.save(made, tmp_path / "model.onnx", save_as_external_data=True, location="w.bin", size_threshold=0)
    with pytest.raises(Unreadable, match="its weights are in another file"):
        onnx_file.read(tmp_path / "model.onnx", SIZE, torch.float32)


@pytest.mark.parametrize("place", ["a constant", "a branch"])
def test_a_tensor_anywhere_in_another_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    monkeypatch.chdir(tmp_path)  # onnxruntime reads what is below the working folder
    (tmp_path / "secret").write_bytes(values(3).tobytes())
    outside = numpy_helper.from_array(np.zeros(3, np.float32), "secret")
    onnx.external_data_helper.set_external_data(outside, "secret", length=12)
    outside.ClearField("raw_data")
    constant = helper.make_node("Constant", [], ["c"], value=outside)
    nodes = [
        helper.make_node("GlobalAveragePool", ["x"], ["m"]),
        helper.make_node("Flatten", ["m"], ["f"]),
        constant,
        helper.make_node("Add", ["f", "c"], ["y"]),
    ]
    weights = []
    if place == "a branch":
        value = helper.make_tensor_value_info("b", TensorProto.FLOAT, [3])
        branch = helper.make_graph([helper.make_node("Identity", ["secret"], ["b"])], "branch", [], [value], [outside])
        nodes[2] = helper.make_node("If", ["yes"], ["c"], then_branch=branch, else_branch=branch)
        weights = [numpy_helper.from_array(np.array(True), "yes")]
    with pytest.raises(Unreadable, match="its weights are in another file"):
        read(in_model(nodes, ("B", 3, *SIZE), weights), tmp_path)


def test_what_onnxruntime_refuses_is_said(tmp_path: Path) -> None:
    with pytest.raises(Unreadable, match=r"onnxruntime refuses it: .*Nonsense"):
        read(means("Nonsense"), tmp_path)


@torch.no_grad()
def test_a_batch_gives_each_image_its_scores_bit_for_bit_again(tmp_path: Path) -> None:
    network, _ = read(means("Softmax"), tmp_path)
    x = torch.randn(5, 3, *SIZE)
    assert torch.equal(network(x), network(x))
