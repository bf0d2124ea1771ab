import json
from pathlib import Path

import pytest
import torch

from services.targets.networks.alexnet import AlexNet
from services.targets.networks.resnet import ResNet

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
