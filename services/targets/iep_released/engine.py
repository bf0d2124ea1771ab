"""The published execution engine: modules of 3×3 convolutions that pass feature maps on, assembled by the program.

Modules keep the names of the published weights inside: `conv1`, `conv2`, `proj` and `res_block`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from services.targets.iep.assembly import Question
from services.targets.iep.prefix import ARITIES, TOKENS


class Residual(nn.Module):
    """The module of `scene` and of each function of one input: two 3×3 convolutions beside the identity."""

    def __init__(self, width: int):
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, padding=1)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """Maps [B, width, h, w] to the same shape."""
        y: Tensor = x + self.conv2(self.conv1(x).relu())
        return y.relu()


class Joining(nn.Module):
    """The module of a function of two inputs: a 1×1 convolution of both, and a residual block."""

    def __init__(self, width: int):
        super().__init__()
        self.proj = nn.Conv2d(2 * width, width, 1)
        self.res_block = Residual(width)

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        """Maps two [B, width, h, w] to one of the same shape."""
        joined: Tensor = self.res_block(self.proj(torch.cat([x, y], dim=1)).relu())
        return joined


@dataclass(frozen=True)
class Results:
    """scores: [Q, tokens], of all answer tokens of the network. nodes: for each question the output [width, h, w] of
    each node of its program."""

    scores: Tensor
    nodes: tuple[tuple[Tensor, ...], ...]


@dataclass(frozen=True)
class _Call:
    """A module applied to results, given by number. depth: how many modules come before it at most."""

    module: str
    image: int
    inputs: tuple[int, ...]
    depth: int


class Engine(nn.Module):
    """Maps features of images and programs of questions about them to scores.

    features: channels of the features. width: of the modules, 128 as published. projection, pooled, hidden: of the
    classifier, 512 channels, 25,088 values after pooling, 1,024 units. answers: tokens that are scored.
    """

    def __init__(self, features: int, width: int, projection: int, pooled: int, hidden: int, answers: int):
        super().__init__()
        self.stem = nn.Sequential(
            nn.Conv2d(features, width, 3, padding=1), nn.ReLU(), nn.Conv2d(width, width, 3, padding=1), nn.ReLU()
        )
        self.functions = nn.ModuleDict(
            {
                token: Joining(width) if arity == 2 else Residual(width)
                for token, arity in zip(TOKENS, ARITIES, strict=True)
            }
        )
        self.classifier = nn.Sequential(
            *(nn.Conv2d(width, projection, 1), nn.ReLU(), nn.MaxPool2d(2), nn.Flatten()),
            *(nn.Linear(pooled, hidden), nn.ReLU(), nn.Linear(hidden, answers)),
        )

    def forward(self, features: Tensor, questions: Sequence[Question]) -> Results:
        """Answers questions about images with features [B, features, h, w]; their programs must be valid.

        Calls of a module at one depth run as one batch. Equal parts of programs about one image are computed once.
        """
        calls: dict[_Call, int] = {}
        numbers = [_numbered(question, calls) for question in questions]
        seen = self.stem(features)
        found: dict[int, Tensor] = {}
        for batch in _batches(calls):
            inputs = [
                torch.stack([found[number] for number in of])
                for of in zip(*(call.inputs for call in batch), strict=True)
            ] or [seen[[call.image for call in batch]]]  # `scene` takes what the stem sees of the image
            outputs: Tensor = self.functions[batch[0].module](*inputs)
            found |= zip((calls[call] for call in batch), outputs.unbind(), strict=True)
        roots = torch.stack([found[of[-1]] for of in numbers])
        return Results(self.classifier(roots), tuple(tuple(found[number] for number in of) for of in numbers))


def _numbered(question: Question, calls: dict[_Call, int]) -> list[int]:
    """Returns the number of each node's call; calls that are new are added to `calls`."""
    found: list[int] = []
    depths: list[int] = []
    for node in question.program.nodes:
        depths.append(1 + max((depths[one] for one in node.inputs), default=-1))
        call = _Call(node.label, question.image, tuple(found[one] for one in node.inputs), depths[-1])
        found.append(calls.setdefault(call, len(calls)))
    return found


def _batches(calls: dict[_Call, int]) -> list[list[_Call]]:
    """Returns the calls of each module at each depth, inputs before the calls that take them."""
    batches: dict[tuple[int, str], list[_Call]] = {}
    for call in calls:
        batches.setdefault((call.depth, call.module), []).append(call)
    return [batches[key] for key in sorted(batches)]
