"""The published network written apart: a question about one image at a time, by recursion, on the published weights."""

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional as F

from services.questions.program import Program

MEAN, STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.224)
State = dict[str, Tensor]


def features(state: State, image: Tensor) -> Tensor:
    """Features [C, 14, 14] of an image [224, 224, 3] in [0,1]."""
    mean, std = (torch.tensor(values, dtype=image.dtype) for values in (MEAN, STD))
    x = ((image - mean) / std).permute(2, 0, 1)[None]

    def layer(conv: str, bn: str, x: Tensor, stride: int = 1) -> Tensor:
        weight = state[f"{conv}.weight"]
        x = F.conv2d(x, weight, stride=stride, padding=weight.shape[-1] // 2)
        scale = state[f"{bn}.weight"] / (state[f"{bn}.running_var"] + 1e-5).sqrt()
        shift = state[f"{bn}.bias"] - state[f"{bn}.running_mean"] * scale
        return x * scale[:, None, None] + shift[:, None, None]

    x = F.max_pool2d(layer("conv1", "bn1", x, 2).relu(), 3, 2, 1)
    for stage in (1, 2, 3):
        block = 0
        while f"layer{stage}.{block}.conv1.weight" in state:
            name = f"layer{stage}.{block}."
            stride = 2 if block == 0 and stage > 1 else 1
            y = layer(f"{name}conv1", f"{name}bn1", x).relu()
            y = layer(f"{name}conv2", f"{name}bn2", y, stride).relu()
            y = layer(f"{name}conv3", f"{name}bn3", y)
            x = (y + (layer(f"{name}downsample.0", f"{name}downsample.1", x, stride) if block == 0 else x)).relu()
            block += 1
    return x[0]


def outputs(state: State, found: Tensor, program: Program) -> list[Tensor]:
    """The output [width, 14, 14] of each node's module, from the features of an image."""

    def conv(name: str, x: Tensor) -> Tensor:
        weight = state[f"{name}.weight"]
        return F.conv2d(x[None], weight, state[f"{name}.bias"], padding=weight.shape[-1] // 2)[0]

    def residual(name: str, x: Tensor) -> Tensor:
        return (x + conv(f"{name}.conv2", conv(f"{name}.conv1", x).relu())).relu()

    stem = conv("stem.2", conv("stem.0", found).relu()).relu()
    made: list[Tensor] = []
    for node in program.nodes:
        name = f"{node.function}[{node.values[0]}]" if node.values else node.function
        taken = [made[one] for one in node.inputs] or [stem]
        if len(taken) == 2:
            made.append(residual(f"{name}.res_block", conv(f"{name}.proj", torch.cat(taken)).relu()))
        else:
            made.append(residual(name, taken[0]))
    return made


def scores(state: State, last: Tensor) -> Tensor:
    """Scores of all answer tokens from the output of the last node."""
    x = F.conv2d(last[None], state["classifier.0.weight"], state["classifier.0.bias"]).relu()
    x = F.max_pool2d(x, 2).flatten(1)
    x = F.linear(x, state["classifier.4.weight"], state["classifier.4.bias"]).relu()
    return F.linear(x, state["classifier.6.weight"], state["classifier.6.bias"])[0]


def written(state: State, question: list[int], steps: int) -> list[int]:
    """The likeliest tokens of a program, by the equations of the LSTM."""

    def read(name: str, states: list[tuple[Tensor, Tensor]], x: Tensor) -> Tensor:
        for layer, (h, c) in enumerate(states):
            gates = state[f"{name}.weight_ih_l{layer}"] @ x + state[f"{name}.bias_ih_l{layer}"]
            gates = gates + state[f"{name}.weight_hh_l{layer}"] @ h + state[f"{name}.bias_hh_l{layer}"]
            i, f, g, o = gates.chunk(4)
            c = f.sigmoid() * c + i.sigmoid() * g.tanh()
            x = o.sigmoid() * c.tanh()
            states[layer] = x, c
        return x

    def zeros() -> list[tuple[Tensor, Tensor]]:
        size = state["decoder_linear.weight"].shape[1]
        return [(torch.zeros(size), torch.zeros(size)) for _ in range(2)]

    states, encoded = zeros(), torch.empty(0)
    for word in question:
        encoded = read("encoder_rnn", states, state["encoder_embed.weight"][word])
    states, before, found = zeros(), 1, list[int]()
    for _ in range(steps):
        x = read("decoder_rnn", states, torch.cat([encoded, state["decoder_embed.weight"][before]]))
        before = int((state["decoder_linear.weight"] @ x + state["decoder_linear.bias"]).argmax())
        found.append(before)
    return found


def double(state: dict[str, Any]) -> State:
    """The same weights in double precision."""
    return {name: value.double() for name, value in state.items()}
