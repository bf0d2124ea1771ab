"""Files that are refused, and scores that are the same each time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from scene_attack.errors import Unreadable
from scene_attack.targets.custom import onnx_file

OPSET = 20
RANDOM = np.random.default_rng(1)
SIZE = (8, 8)


def values(*shape: int) -> Any:
    return RANDOM.normal(size=shape).astype(np.float32)


def in_model(nodes: list[onnx.NodeProto], shape: Sequence[Any], weights: Sequence[Any] = (), opset: int = OPSET) -> Any:
    x = helper.make_tensor_value_info("x", TensorProto.FLOAT, shape)
    y = onnx.ValueInfoProto(name="y")
    graph = helper.make_graph(nodes, "g", [x], [y], list(weights))
    found = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=9)
    return onnx.shape_inference.infer_shapes(found)


def means(kind: str, opset: int = OPSET, **attributes: Any) -> Any:
    """A network of one operator on the means of the channels."""
    nodes = [
        helper.make_node("GlobalAveragePool", ["x"], ["m"]),
        helper.make_node("Flatten", ["m"], ["f"]),
        helper.make_node(kind, ["f"], ["y"], **attributes),
    ]
    return in_model(nodes, ("B", 3, *SIZE), opset=opset)


def read(made: onnx.ModelProto, root: Path) -> torch.nn.Module:
    onnx.save(made, root / "model.onnx")
    return onnx_file.read(root / "model.onnx", SIZE)


def test_weights_in_another_file_are_refused(tmp_path: Path) -> None:
    weights = [numpy_helper.from_array(values(40, 3, 8, 8), "w")]
    made = in_model([helper.make_node("Conv", ["x", "w"], ["y"])], ("B", 3, *SIZE), weights)
    onnx.save(made, tmp_path / "model.onnx", save_as_external_data=True, location="w.bin", size_threshold=0)
    with pytest.raises(Unreadable, match="its weights are in another file"):
        onnx_file.read(tmp_path / "model.onnx", SIZE)


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
    network = read(means("Softmax"), tmp_path)
    x = torch.randn(5, 3, *SIZE)
    assert torch.equal(network(x), network(x))
