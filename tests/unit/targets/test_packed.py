"""Packed convolutions against plain ones, and against the whole network in float64."""

from copy import deepcopy

import pytest
import torch
from torch import Tensor, nn

from services.targets import registry
from services.targets.classifier import Classifier
from services.targets.efficientnet_lite import Convolution
from services.targets.packed import PackedConvolution, pack, packable

pytestmark = pytest.mark.skipif(not packable(torch.float32), reason="this torch has no oneDNN")
KINDS = [
    # inputs, outputs, kernel, stride, groups, relu, size: the kinds of Lite0, and odd sizes
    (3, 8, 3, 2, 1, True, 12),
    (16, 16, 3, 1, 16, True, 9),
    (16, 16, 3, 2, 16, True, 10),
    (16, 16, 5, 2, 16, True, 14),
    (16, 16, 5, 2, 16, True, 7),
    (16, 16, 5, 1, 16, False, 8),
    (16, 24, 1, 1, 1, False, 6),
    (8, 16, 3, 1, 1, True, 6),
]


def convolution(inputs: int, outputs: int, kernel: int, stride: int, groups: int, relu: bool) -> Convolution:
    made = Convolution(inputs, outputs, kernel, stride, groups, relu)
    random = torch.Generator().manual_seed(0)
    made.weight.data.normal_(generator=random)
    made.bias.data.normal_(generator=random)
    return made.to(memory_format=torch.channels_last)


def gradient(network: nn.Module, x: Tensor, slope: Tensor) -> Tensor:
    leaf = x.clone().requires_grad_()
    return torch.autograd.grad(network(leaf), leaf, slope)[0]


@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_a_packed_convolution_is_the_plain_one(kind: tuple[int, int, int, int, int, bool, int], batch: int) -> None:
    *shape, size = kind
    plain = convolution(*shape)
    packed = PackedConvolution(plain, (size, size))
    exact = deepcopy(plain).double()
    random = torch.Generator().manual_seed(1)
    x = 2 * torch.randn(batch, shape[0], size, size, generator=random).contiguous(memory_format=torch.channels_last)
    wanted = exact(x.double())
    slope = torch.randn(wanted.shape, generator=random)
    # sums of at most 75 products of size 10 in float32
    torch.testing.assert_close(packed(x).double(), wanted, rtol=0, atol=1e-4)
    torch.testing.assert_close(
        gradient(packed, x, slope).double(), gradient(exact, x.double(), slope.double()), rtol=0, atol=1e-4
    )


@pytest.fixture(scope="module")
def target() -> Classifier:
    found = registry.load("efficientnet-lite0")
    assert isinstance(found, Classifier)
    return found


@pytest.mark.parametrize("batch", [1, 2])
def test_the_network_answers_as_in_float64(target: Classifier, batch: int) -> None:
    twin = registry.load("efficientnet-lite0", torch.float64)
    images = torch.rand(batch, 224, 224, 3, generator=torch.Generator().manual_seed(0))

    def score(of: Classifier) -> Tensor:
        leaf = images.to(of.dtype).requires_grad_()
        return torch.autograd.grad(of.logits(leaf)[:, 3].sum(), leaf)[0].double()

    assert isinstance(twin, Classifier)
    assert any(isinstance(module, PackedConvolution) for module in target.network.modules())
    assert not any(isinstance(module, PackedConvolution) for module in twin.network.modules())
    # a ReLU6 on the other side of its kink changes single values; the whole stays: seen 2e-3
    assert float((score(target) - score(twin)).norm() / score(twin).norm()) < 0.02
    assert torch.equal(score(target), score(target))


@torch.no_grad()
def test_pictures_of_another_size_take_the_plain_way() -> None:
    plain = nn.Sequential(convolution(3, 8, 3, 2, 1, True))
    packed = deepcopy(plain)
    pack(packed, (12, 12))
    x = torch.rand(1, 3, 10, 10)
    assert torch.equal(packed(x), plain(x))
