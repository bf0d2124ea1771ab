"""The modules, stacked by kind: the weights of all modules of a kind are one tensor, whose first axis is the module.

A batch of calls of different modules of a kind is then one batched product with the gathered weights. A map is a mask
over the P cells of an image that may hold an object: one logit for each, whether it holds the centre of one of the set.
"""

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import torch
from torch import Tensor, nn

WIDTH = 64
"""Channels of image features, of activations and of vectors inside the engine."""
LOGIT_SCALE = 8.0
"""Mask logits are divided by it where modules take them; it is the size of large ones."""
COORDINATE_FAN_IN = 16
"""Sets the size of the weights of coordinates before training, so that features outweigh them."""
FIRST_MASK = -3.0
"""Bias of the mask logits before training: few cells hold an object."""


class Seen(NamedTuple):
    """What modules see of images.

    features: [B, 66, P], image features and two coordinates. gate: [B, P] in [0,1], the weight of each cell.
    """

    features: Tensor
    gate: Tensor

    def product(self, rows: Tensor) -> Tensor:
        """Returns products [n, m, P] of `rows` [n, m, 66] with the features of n images, or of the only one."""
        return torch.bmm(rows, self.features) if len(self.features) > 1 else rows @ self.features[0]


class Maps(NamedTuple):
    """A stack of maps.

    logits: [n, P], of the mask. signals: [n, 2, P], the mask and its scaled logits, which are what modules take of it.
    weights: [n, P, 2], the mask and the softmax of its logits over the cells. looks and places: [n, 64, 1] and
    [n, 2, 1], features and coordinates averaged with that softmax: those of the object that is attended to.
    """

    logits: Tensor
    signals: Tensor
    weights: Tensor
    looks: Tensor
    places: Tensor


def attend(logits: Tensor, seen: Seen) -> Maps:
    """Returns maps with mask logits [n, P]; `seen` is of n images, or of one."""
    mask = logits.sigmoid() * seen.gate
    focus = (logits + seen.gate.clamp_min(torch.finfo(logits.dtype).tiny).log()).softmax(1)
    transposed = Seen(seen.features.transpose(1, 2), seen.gate)
    pooled = transposed.product(focus[:, None]).transpose(1, 2)
    signals = torch.stack([mask, logits / LOGIT_SCALE], dim=1)
    return Maps(logits, signals, torch.stack([mask, focus], dim=2), pooled[:, :WIDTH], pooled[:, WIDTH:])


def of(weights: Tensor, chosen: Tensor) -> Tensor:
    """Returns the weights of the chosen modules, int64 [n]."""
    return weights.index_select(0, chosen)


def random(modules: int, outputs: int, inputs: int, fan_in: int) -> nn.Parameter:
    """Returns weights [modules, outputs, inputs] of layers with ReLU; `fan_in` is the number of inputs of a sum."""
    return nn.Parameter(torch.randn(modules, outputs, inputs) * sqrt(2 / fan_in))


def constant(modules: int, outputs: int, value: float = 0.0) -> nn.Parameter:
    """Returns biases [modules, outputs, 1]."""
    return nn.Parameter(torch.full((modules, outputs, 1), value))


class FirstLayer(nn.Module):
    """The first layer of modules that take maps: 1×1 convolutions of the image's features, of coordinates, of the masks
    of the inputs, and of what each input attends to.

    Coordinates enter twice: as they are, and relative to the attended position. What is attended to also scales the
    weights of the features, so that a module can compare a cell with it.
    """

    def __init__(self, modules: int, inputs: int):
        super().__init__()
        fan_in = WIDTH * (1 + inputs)
        self.image = random(modules, WIDTH, WIDTH, fan_in)
        self.scaled = random(modules, WIDTH, WIDTH * inputs, fan_in)
        self.attended = random(modules, WIDTH, WIDTH * inputs, fan_in)
        self.masks = random(modules, WIDTH, 2 * inputs, 2 * inputs)
        self.absolute = random(modules, WIDTH, 2, COORDINATE_FAN_IN)
        self.relative = random(modules, WIDTH, 2 * inputs, COORDINATE_FAN_IN)
        self.bias = constant(modules, WIDTH)
        self.inputs = inputs

    def forward(self, chosen: Tensor, seen: Seen, inputs: Sequence[Maps]) -> Tensor:
        """Returns activations [n, 64, P] of stacks of n maps, one for each input.

        chosen: int64 [n], the modules. seen: of each call's image, or of the only one.
        """
        looks = torch.cat([one.looks for one in inputs], dim=1)
        places = torch.cat([one.places for one in inputs], dim=1)
        relative = of(self.relative, chosen)
        bias = torch.baddbmm(of(self.bias, chosen), of(self.attended, chosen), looks)
        bias = bias.baddbmm_(relative, places, alpha=-1)
        features = of(self.scaled, chosen) * looks.transpose(1, 2)
        features = features.view(-1, WIDTH, self.inputs, WIDTH).sum(2) + of(self.image, chosen)
        coordinates = relative.view(-1, WIDTH, self.inputs, 2).sum(2) + of(self.absolute, chosen)
        x = seen.product(torch.cat([features, coordinates], dim=2))
        ones = looks.new_ones(()).expand(len(chosen), 1, x.shape[2])
        signals = torch.cat([*(one.signals for one in inputs), ones], dim=1)
        return x.baddbmm_(torch.cat([of(self.masks, chosen), bias], dim=2), signals).relu_()


class MapModules(nn.Module):
    """Modules whose result is a map: a first layer, a residual block of two 1×1 convolutions, and a mask head."""

    def __init__(self, modules: int, inputs: int):
        super().__init__()
        self.first = FirstLayer(modules, inputs)
        self.second = random(modules, WIDTH, WIDTH, WIDTH)
        self.second_bias = constant(modules, WIDTH)
        self.third = random(modules, WIDTH, WIDTH, 4 * WIDTH)
        self.third_bias = constant(modules, WIDTH)
        self.mask = random(modules, 1, WIDTH, 4 * WIDTH)
        self.mask_bias = constant(modules, 1, FIRST_MASK)

    def forward(self, chosen: Tensor, seen: Seen, inputs: Sequence[Maps]) -> Maps:
        """Returns n maps; arguments as of `FirstLayer`."""
        x = self.first(chosen, seen, inputs)
        y = torch.bmm(of(self.second, chosen), x).add_(of(self.second_bias, chosen)).relu_()
        x = (x + of(self.third_bias, chosen)).baddbmm_(of(self.third, chosen), y).relu_()
        return attend(torch.bmm(of(self.mask, chosen), x).add_(of(self.mask_bias, chosen))[:, 0], seen)


class ReadingModules(nn.Module):
    """Modules from a map to a vector: a first layer, summed over the set and averaged over what is attended to."""

    def __init__(self, modules: int):
        super().__init__()
        self.first = FirstLayer(modules, 1)
        self.second = random(modules, WIDTH, 2 * WIDTH, 2 * WIDTH)
        self.second_bias = constant(modules, WIDTH)

    def forward(self, chosen: Tensor, seen: Seen, inputs: Sequence[Maps]) -> Tensor:
        """Returns vectors [n, 64]; arguments as of `FirstLayer`."""
        x = self.first(chosen, seen, inputs)
        pooled = torch.bmm(x, inputs[0].weights).transpose(1, 2).flatten(1)[:, :, None]
        return torch.baddbmm(of(self.second_bias, chosen), of(self.second, chosen), pooled)[:, :, 0].relu()


class ComparingModules(nn.Module):
    """Modules from two vectors to a vector, by way of both vectors and of both distributions over the answers."""

    def __init__(self, modules: int, answers: int):
        super().__init__()
        inputs = 2 * WIDTH + 3 * answers
        self.first = random(modules, WIDTH, inputs, inputs)
        self.first_bias = constant(modules, WIDTH)
        self.second = random(modules, WIDTH, WIDTH, WIDTH)
        self.second_bias = constant(modules, WIDTH)

    def forward(self, chosen: Tensor, vectors: Sequence[Tensor], scores: Sequence[Tensor]) -> Tensor:
        """Returns vectors [n, 64] of two stacks of vectors [n, 64] with their scores [n, answers]."""
        one, other = (score.softmax(1) for score in scores)
        x = torch.cat([*vectors, one, other, one * other], dim=1)[:, :, None]
        x = torch.baddbmm(of(self.first_bias, chosen), of(self.first, chosen), x).relu()
        return torch.baddbmm(of(self.second_bias, chosen), of(self.second, chosen), x)[:, :, 0].relu()
