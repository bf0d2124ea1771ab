"""Folders with a mistake: each is refused by name and reason, at the request, and never stops the others."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import onnx
import pytest
import torch
from onnx import TensorProto, helper
from torch import Tensor, nn

from scene_attack.errors import InvalidRequest
from scene_attack.runs.prepare import prepare
from scene_attack.runs.spec import parse
from scene_attack.targets.info import TARGETS
from tests.unit.jobs.small import LIBRARY
from tests.unit.targets.custom import small_network
from tests.unit.targets.custom.conftest import Scan
from tests.unit.targets.custom.small_network import LABELS, SIZE, folder, save_onnx, save_pt2, save_safetensors

pytestmark = pytest.mark.slow

MODULE = small_network.__name__
SCENE = {"camera": {"size": [48, 48]}, "objects": [{"mesh": "primitive/sphere"}]}


def net(*files: str, **fields: Any) -> Callable[[Path], None]:
    """Makes a folder "net" with a card of these fields, and with empty files."""

    def make(root: Path) -> None:
        made = folder(root, "net", **fields)
        for name in files:
            (made / name).touch()

    return make


card, weights = partial(net, "model.pt2"), partial(net, "model.safetensors")


def without_card(root: Path) -> None:
    card()(root)
    (root / "net" / "card.json").unlink()


def not_json(root: Path) -> None:
    card()(root)
    (root / "net" / "card.json").write_text("labels: [a]")


FOUND_AT_ONCE: dict[str, tuple[Callable[[Path], None], str]] = {
    "no card": (without_card, "card.json: there is no such file; add one"),
    "a card that is no JSON": (not_json, "card.json: it is not JSON"),
    "an unknown field": (card(lables=[]), "card.json: lables: there is no such field; .*did you mean 'labels'"),
    "no labels": (card(labels=None), "card.json: labels: "),
    "a label that is no Unicode": (card(labels=["\ud800", "b"]), r"card.json: labels.0: .*not \"\\ud800\""),
    "a mean of two numbers": (card(preprocessing={"mean": [0, 0]}), "card.json: preprocessing.mean: "),
    "a std of 0": (card(preprocessing={"std": [1, 0, 1]}), "card.json: preprocessing.std.1: .* above 0"),
    "labels in a file elsewhere": (card(labels="../labels.txt"), "card.json: labels: must be a list"),
    "labels in a file that is not there": (card(labels="labels.txt"), "labels.txt: there is no such file"),
    "two model files": (net("model.pt2", "model.onnx"), "model: it has model.pt2 and model.onnx; keep one"),
    "a model file and a factory": (card(factory="a:b"), "model: it has model.pt2 and factory of the card; keep one"),
    "no model": (net(), "model: it has none of model.pt2, model.onnx, model.safetensors"),
    "a pickle": (net("weights.pt"), "weights.pt is a pickle, which can run any code and is never read"),
    "weights without an architecture": (weights(architecture=None), "architecture: is needed; there are .*small"),
    "weights of an unknown one": (weights(architecture="smal"), "there is no 'smal'; .*did you mean 'small'"),
    "an architecture for a program": (card(architecture="small"), "architecture: is only for model.safetensors"),
    "a factory that is not allowed": (net(factory="os:getcwd"), "card.json: factory: .*'os:getcwd' is not allowed"),
    "a factory that is no name": (net(factory="os.getcwd()"), "card.json: factory: "),
    "an address that is not allowed": (net(endpoint="https://a.test/"), "card.json: endpoint: .*not allowed"),
}


@pytest.mark.parametrize("mistake", FOUND_AT_ONCE)
def test_a_mistake_in_the_folder_is_found_without_reading_the_network(scan: Scan, tmp_path: Path, mistake: str) -> None:
    make, said = FOUND_AT_ONCE[mistake]
    make(tmp_path)
    save_pt2(folder(tmp_path, "sound") / "model.pt2")
    net, sound = scan()
    assert sound.error is None
    assert "sound" in TARGETS
    assert "net" not in TARGETS
    assert net.error is not None
    net.error.encode()  # /readyz shows it
    with pytest.raises(InvalidRequest, match=f"target.name: target 'net' is not available: .*{said}"):
        prepare(parse({"scene": SCENE, "target": {"name": "net"}, "attack": {"renderer": "pyrender"}}), LIBRARY)


def test_folders_that_cannot_be_names(scan: Scan, tmp_path: Path) -> None:
    for name in ("Net", "efficientnet-lite0"):
        (folder(tmp_path, name) / "model.pt2").touch()
    (tmp_path / ".hidden").mkdir()
    (tmp_path / "a-file").touch()
    errors = [one.error for one in scan()]
    assert errors == [
        "name: use a-z, 0-9, - and _ in a folder's name",
        "name: there is a target of this name already; rename the folder",
    ]


def test_no_folder_is_said(tmp_path: Path, scan: Scan) -> None:
    tmp_path.rmdir()
    assert [one.error for one in scan()] == ["it cannot be read: No such file or directory"]
    tmp_path.mkdir()


class TwoOutputs(nn.Module):
    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        means = x.mean(dim=(2, 3))
        return means, -means


class TwoInputs(nn.Module):
    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        return x.mean(dim=(2, 3)) + y


def exported(module: nn.Module, *more: Tensor) -> Callable[[Path], None]:
    def make(root: Path) -> None:
        program = torch.export.export(module, (torch.zeros(1, 3, *SIZE), *more))
        torch.export.save(program, folder(root, "net", labels=["a", "b", "c"]) / "model.pt2")

    return make


def in_onnx(root: Path, inputs: dict[str, tuple[Any, ...]], outputs: list[str], *nodes: onnx.NodeProto) -> None:
    given = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in inputs.items()]
    made = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs]
    model = helper.make_model(
        helper.make_graph(list(nodes), "g", given, made), opset_imports=[helper.make_opsetid("", 18)], ir_version=10
    )
    onnx.save(model, folder(root, "net") / "model.onnx")


def two_inputs(root: Path) -> None:
    inputs = {"image": ("B", 3, 32, 32), "mask": ("B", 3, 32, 32)}
    in_onnx(root, inputs, ["scores"], helper.make_node("Add", ["image", "mask"], ["scores"]))


def channels_last(root: Path) -> None:
    in_onnx(root, {"x": ("B", 32, 32, 3)}, ["y"], helper.make_node("ReduceMean", ["x"], ["y"]))


def not_onnx(root: Path) -> None:
    (folder(root, "net") / "model.onnx").write_bytes(b"\xff not onnx")


def other_labels(root: Path) -> None:
    save_onnx(folder(root, "net", labels=LABELS[:4]) / "model.onnx")


def another_size(root: Path) -> None:
    save_pt2(folder(root, "net", preprocessing={"input_size": [64, 64]}) / "model.pt2")


def less_weights(root: Path) -> None:
    from safetensors.torch import save_file

    state = small_network.network().state_dict()
    del state["head.bias"]
    save_file(state, folder(root, "net", architecture="small") / "model.safetensors")


def more_classes(root: Path) -> None:
    save_safetensors(folder(root, "net", architecture="small", labels=[*LABELS, "more"]) / "model.safetensors")


FOUND_AT_THE_REQUEST: dict[str, tuple[Callable[[Path], None], str]] = {
    "a program of two outputs": (exported(TwoOutputs()), "model.pt2: it returns 2 values"),
    "a program of two inputs": (exported(TwoInputs(), torch.zeros(1, 3)), "model.pt2: it has 2 inputs"),
    "an .onnx with two inputs": (two_inputs, r"model.onnx: it has 2 inputs \(image, mask\); one is due"),
    "an .onnx with channels last": (channels_last, "its input is any × 32 × 32 × 3; images .B, 3, height, width. are"),
    "no ONNX": (not_onnx, "model.onnx: it is no ONNX model"),
    "labels that do not fit": (other_labels, r"returns torch.float32 \[2, 5\] .* \[2, 4\] is due"),
    "another input size": (another_size, "but the card's preprocessing.input_size is 64×64"),
    "a weight that is missing": (less_weights, "does not fit small with 5 classes: it lacks head.bias"),
    "weights of another shape": (more_classes, r"with 6 classes: head.weight has the shape \[5, 128\]; \[6, 128\]"),
    "a MAITE model of other labels": (
        net(factory=f"{MODULE}:maite", labels=LABELS[::-1], output="probabilities"),
        "metadata.index2label has 5 labels, which are not",
    ),
    "a factory that fails": (
        net(factory=f"{MODULE}:fails"),
        "small_network:fails fails: OSError: weights.bin is not there",
    ),
}


@pytest.mark.parametrize("mistake", FOUND_AT_THE_REQUEST)
def test_a_network_that_cannot_be_used_is_refused_at_the_request(scan: Scan, tmp_path: Path, mistake: str) -> None:
    make, said = FOUND_AT_THE_REQUEST[mistake]
    make(tmp_path)
    (net,) = scan(target_factories=f"{MODULE}:maite,{MODULE}:fails")
    assert net.error is None
    with pytest.raises(InvalidRequest, match=f"target 'net' .*{said}") as refused:
        prepare(parse({"scene": SCENE, "target": {"name": "net"}, "attack": {"renderer": "pyrender"}}), LIBRARY)
    assert refused.value.field == "target.name"


def test_labels_may_be_a_file_or_those_of_imagenet(scan: Scan, tmp_path: Path) -> None:
    lines = folder(tmp_path, "lines", labels="names.txt")
    (lines / "names.txt").write_text("a b\n\nc\n")
    (lines / "model.pt2").touch()
    (folder(tmp_path, "thousand", labels="imagenet") / "model.pt2").touch()
    assert [one.error for one in scan()] == [None, None]
    assert TARGETS["lines"].labels() == ("a b", "c")
    assert TARGETS["thousand"].info.classes == 1000
    assert TARGETS["lines"].info.card_sha256 != TARGETS["thousand"].info.card_sha256
    assert json.loads((lines / "card.json").read_text())["labels"] == "names.txt"
