"""The same network in every format gives the same answers, and the same adversary where it has gradients."""

from pathlib import Path
from typing import Any, ClassVar

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional as F

import scene_attack as sa
from scene_attack.errors import InvalidRequest
from scene_attack.runs.execute import execute
from scene_attack.runs.prepare import prepare
from scene_attack.runs.result import Result
from scene_attack.runs.spec import parse
from scene_attack.runs.target_check import check
from scene_attack.targets import registry
from scene_attack.targets.custom.loading import MaiteNetwork
from scene_attack.targets.info import TARGETS
from tests.unit.jobs.small import LIBRARY
from tests.unit.targets.custom import small_network
from tests.unit.targets.custom.conftest import Scan
from tests.unit.targets.custom.small_network import LABELS, MEAN, SIZE, STD, WRITERS, folder, network

pytestmark = pytest.mark.slow

MODULE = small_network.__name__
FACTORIES = {"target_factories": f"{MODULE}:network,{MODULE}:maite,{MODULE}:numpy_maite,{MODULE}:fails"}
SCENE = {"camera": {"size": [48, 48]}, "objects": [{"mesh": "primitive/sphere"}]}
FGSM = {"renderer": "image", "base_renderer": "pyrender", "method": "fgsm", "steps": 40}
ALL = ("exported", "exported-1", "onnx", "onnx-2", "weights", "module", "maite", "maite-numpy")
WITHOUT_GRADIENTS = {"onnx", "onnx-2", "maite-numpy"}
WITH_GRADIENTS = tuple(name for name in ALL if name not in WITHOUT_GRADIENTS)


@pytest.fixture(scope="module")
def everything(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the small network in each format."""
    root = tmp_path_factory.mktemp("targets")
    small_network.save_pt2(folder(root, "exported") / "model.pt2")
    small_network.save_pt2(folder(root, "exported-1") / "model.pt2", fixed=1)
    small_network.save_onnx(folder(root, "onnx") / "model.onnx")
    small_network.save_onnx(folder(root, "onnx-2") / "model.onnx", fixed=2)
    small_network.save_safetensors(folder(root, "weights", architecture="small") / "model.safetensors")
    folder(root, "module", factory=f"{MODULE}:network")
    folder(root, "maite", factory=f"{MODULE}:maite", output="probabilities")
    folder(root, "maite-numpy", factory=f"{MODULE}:numpy_maite", output="probabilities")
    return root


def reference(images: Tensor) -> Tensor:
    """Log-probabilities in float64, by the module itself and the preprocessing written out."""
    x = images.double().permute(0, 3, 1, 2)
    x = F.interpolate(x, SIZE, mode="bilinear", antialias=True)
    mean, std = (torch.tensor(of, dtype=torch.float64)[:, None, None] for of in (MEAN, STD))
    return network().double()((x - mean) / std).log_softmax(dim=1)


@pytest.fixture
def formats(scan: Scan, everything: Path) -> None:
    assert [one.error for one in scan(everything, **FACTORIES)] == [None] * len(ALL)


@pytest.mark.usefixtures("formats")
def test_all_formats_give_the_same_answers() -> None:
    images = torch.rand(5, 48, 40, 3, generator=torch.Generator().manual_seed(1))
    wanted = reference(images)
    for name in ALL:
        found = registry.load(name).logits(images).double().log_softmax(dim=1)
        torch.testing.assert_close(found, wanted, rtol=0, atol=1e-4, msg=name)  # seen 3e-6


@pytest.mark.usefixtures("formats")
def test_they_have_gradients_where_they_can_and_say_so() -> None:
    listed = {name: TARGETS[name].info.differentiable for name in ALL}
    assert listed == dict.fromkeys(ALL[:5], True) | dict.fromkeys(ALL[5:], None) | {"onnx": False, "onnx-2": False}
    assert [name for name in ALL if registry.has_gradient(name)] == list(WITH_GRADIENTS)
    assert "it fails on images that need gradients" in registry.no_gradient("maite-numpy")
    assert "torch.export.save" in registry.no_gradient("onnx")
    leaf = torch.rand(2, 32, 32, 3, generator=torch.Generator().manual_seed(2)).requires_grad_()
    exact = leaf.detach().double().requires_grad_()
    (wanted,) = torch.autograd.grad(reference(exact)[:, 1].sum(), exact)
    for name in WITH_GRADIENTS:
        scores = registry.load(name).logits(leaf).log_softmax(dim=1)
        (found,) = torch.autograd.grad(scores[:, 1].sum(), leaf)
        torch.testing.assert_close(found.double(), wanted, rtol=1e-3, atol=1e-5, msg=name)


def job(name: str, root: Path, **attack: Any) -> Result:
    spec = parse({"scene": SCENE, "target": {"name": name}, "attack": FGSM | attack})
    return execute(spec, root / f"out-{name}", LIBRARY)


@pytest.mark.usefixtures("formats")
def test_they_give_the_same_adversary(tmp_path: Path) -> None:
    found = {name: job(name, tmp_path) for name in WITH_GRADIENTS}
    first = found["exported"]
    assert first.verified
    assert first.original.label != first.attacked.label
    stored = load_file(tmp_path / "out-exported" / "perturbation.safetensors")["image"]
    for name, result in found.items():
        assert (result.verified, result.change.step, result.attacked.label) == (
            True,
            first.change.step,
            first.attacked.label,
        ), name
        same = load_file(tmp_path / f"out-{name}" / "perturbation.safetensors")["image"]
        # the sign of a gradient of nearly zero is decided by rounding
        assert float((same != stored).float().mean()) < 0.01, name
        assert result.provenance.card_sha256 == TARGETS[name].info.card_sha256
    assert found["exported"].provenance.weights_sha256 != found["weights"].provenance.weights_sha256


@pytest.mark.usefixtures("formats")
def test_a_module_that_is_passed_gives_it_too(tmp_path: Path) -> None:
    module = network().train()
    preprocessing = {"input_size": SIZE, "mean": MEAN, "std": STD}
    target = sa.target(module, labels=LABELS, preprocessing=preprocessing, name="mine")
    result = sa.attack(SCENE, target, FGSM).record
    wanted = job("module", tmp_path)
    assert result.attacked.label == wanted.attacked.label
    assert result.change.step == wanted.change.step
    assert module.training  # it was copied
    assert "mine" not in TARGETS


@pytest.mark.usefixtures("formats")
def test_a_module_without_labels_has_numbers(tmp_path: Path) -> None:
    preprocessing = {"input_size": SIZE, "mean": MEAN, "std": STD}
    target = sa.target(network(), preprocessing=preprocessing, name="numbered")
    result = sa.attack(SCENE, target, FGSM, out=tmp_path / "out").record
    wanted = job("module", tmp_path)
    assert result.attacked.label == str(LABELS.index(wanted.attacked.label))
    assert sa.images(tmp_path / "out").attacked.size == (result.spec["scene"]["camera"]["size"][1],) * 2


@pytest.mark.parametrize(
    ("spec", "field"),
    [
        ({"attack": {"steps": -1}}, "attack.steps"),
        ({"colour": 1}, "colour"),
    ],
)
def test_a_field_that_has_no_place_in_a_request_is_named(spec: dict[str, Any], field: str) -> None:
    with pytest.raises(InvalidRequest) as refused:
        sa.attack(SCENE, network(), **spec)
    assert refused.value.field == field


def test_a_module_that_takes_no_such_image_is_told_the_size() -> None:
    with pytest.raises(
        InvalidRequest, match=r"takes no images \[1, 3, 224, 224\].*preprocessing.input_size"
    ) as refused:
        sa.attack(SCENE, torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(27, 2)))
    assert refused.value.field == "target"


@pytest.mark.parametrize(
    ("name", "reason"), [("maite-numpy", "it fails on images that need gradients"), ("onnx", "torch.export.save")]
)
@pytest.mark.usefixtures("formats")
def test_a_gradient_method_on_scores_only_is_refused(name: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=f"{reason}.*methods without") as refused:
        prepare(parse({"scene": SCENE, "target": {"name": name}, "attack": FGSM}), LIBRARY)
    assert refused.value.field == "attack.method"


@pytest.mark.usefixtures("formats")
def test_scores_of_onnx_are_attacked_without_gradients(tmp_path: Path) -> None:
    assert job("onnx", tmp_path, method="square", steps=400, epsilon={"image": 0.3}).verified


@pytest.mark.parametrize("name", ["exported", "onnx", "maite-numpy"])
@pytest.mark.usefixtures("formats")
def test_a_check_shows_what_it_is(name: str) -> None:
    said: list[str] = []
    found = check(name, "primitive/sphere", LIBRARY, said.append)
    assert found.target.name == name
    assert len(said) == 4
    assert {answer.label for answer in found.answers} == set(LABELS)
    assert sum(answer.probability for answer in found.answers) == pytest.approx(1)
    assert found.gradient == (found.no_gradient is None) == (name == "exported")
    assert all(seconds > 0 for seconds in found.seconds.values())


@pytest.mark.parametrize("channels", ["rgb", "bgr"])
@pytest.mark.parametrize("resize", ["bilinear", "bicubic"])
def test_the_card_says_how_an_image_becomes_the_input(scan: Scan, tmp_path: Path, channels: str, resize: str) -> None:
    about = {"input_size": SIZE, "mean": MEAN, "std": STD, "channels": channels, "resize": resize}
    WRITERS["model.pt2"](folder(tmp_path, "net", preprocessing=about) / "model.pt2")
    scan()
    images = torch.rand(2, 20, 24, 3, generator=torch.Generator().manual_seed(1))
    x = F.interpolate(images.double().permute(0, 3, 1, 2), SIZE, mode=resize, antialias=True).clamp(0, 1)
    mean, std = (torch.tensor(of, dtype=torch.float64)[:, None, None] for of in (MEAN, STD))
    x = (x - mean) / std
    wanted = network().double()(x.flip(1) if channels == "bgr" else x)
    torch.testing.assert_close(registry.load("net").logits(images).double(), wanted, rtol=0, atol=1e-4)


class MaiteModule(nn.Module):
    """A MAITE model that is a torch module, too."""

    metadata: ClassVar = {"id": "module"}

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Flatten(), nn.Dropout(0.5), nn.Linear(12, 3))

    def forward(self, batch: list[Tensor]) -> list[Tensor]:
        assert not self.training
        return list(self.layers(torch.stack(list(batch))))


def test_a_maite_model_that_is_a_module_does_not_move_to_a_device() -> None:
    """It gets CPU tensors wherever the network is."""
    model = MaiteModule()
    wrapped = MaiteNetwork(model, (2, 2))
    assert wrapped.scores_only is None
    wrapped.to(torch.float64)
    assert {value.dtype for value in model.parameters()} == {torch.float32}
    assert wrapped(torch.ones(2, 3, 2, 2, dtype=torch.float64)).shape == (2, 3)
