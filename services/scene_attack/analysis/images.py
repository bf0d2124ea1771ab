"""An image of an attack: its PNG file, how visible its change is, and the network's answer to it.

How visible a change is is the paper's perceptibility p, for images and parameter groups (section 3.3). p of an image is
taken twice: on the float images, as the paper's is, and on the images as they are saved, of 8 bits. The two differ
where a change is smaller than a step of 1/255: a change of 0.002 of every value has p 3.5e-3, and p 6.8e-3 once it is
saved, because each value is rounded to the next step.
"""

from io import BytesIO
from math import sqrt
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from scene_attack.analysis.records import Answer
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.rendering.declaration import RENDERERS
from scene_attack.rendering.protocol import Parameters
from scene_attack.targets.scores import log_odds, probability

MAGNIFICATION = 5
"""Factor by which differences are shown, as in the paper's figures."""


def magnified(original: Tensor, attacked: Tensor) -> Tensor:
    """The image (attacked − original)·5 + 128, clipped to 0…255; all three images are uint8 [H, W, 3]."""
    change = attacked.to(torch.int32) - original.to(torch.int32)
    return (change * MAGNIFICATION + 128).clamp(0, 255).to(torch.uint8)


def save_png(image: Tensor, path: Path) -> None:
    """Writes a uint8 image [H, W, 3]; the same image gives the same bytes."""
    path.write_bytes(png(image))


def png(image: Tensor) -> bytes:
    """A uint8 image [H, W, 3] as the bytes of a PNG file."""
    buffer = BytesIO()
    Image.fromarray(image.numpy()).save(buffer, format="PNG", optimize=False)
    return buffer.getvalue()


def load_png(path: Path) -> Tensor:
    """Reads an image as uint8 [H, W, 3]. Raises OSError, also for a file that is not an image."""
    with Image.open(path) as image:
        return pixels(image)


def pixels(image: Image.Image) -> Tensor:
    """An image as uint8 [H, W, 3]."""
    data = bytearray(image.convert("RGB").tobytes())
    return torch.frombuffer(data, dtype=torch.uint8).reshape(image.height, image.width, 3)


FULL_RANGE = sqrt(3)
"""Largest p of an image, that of black against white: the squared norm of an RGB change is at most 3."""


def perceptibility(change: Tensor, vector_axes: int = 1) -> float:
    """p = sqrt(mean of ‖Δ‖²), in float64. Δ is a vector along the last `vector_axes` axes; the mean is over the others.

    For the change of an image, [H, W, 3], the mean is over pixels.
    """
    squares = change.detach().double().square()
    if vector_axes:
        squares = squares.flatten(-vector_axes).sum(dim=-1)
    return float(squares.mean().sqrt())


def of_float_images(original: Tensor, attacked: Tensor) -> float:
    """p(ΔY) of two images [H, W, 3] in [0,1] before they are rounded: the paper's p, from 0 to `FULL_RANGE`."""
    return perceptibility(attacked.double() - original.double())


def of_images(original: Tensor, attacked: Tensor) -> float:
    """p(ΔY) of two saved images, uint8 [H, W, 3], with RGB values scaled to [0,1]: from 0 to `FULL_RANGE`."""
    return perceptibility((attacked.double() - original.double()) / 255)


def of_groups(renderer: str, perturbation: Parameters) -> dict[str, float]:
    """p of each group of a perturbation, in the group's units. `renderer` is the name of a registered renderer."""
    declared = RENDERERS[renderer]
    return {name: perceptibility(value, declared.group(name).vector_axes) for name, value in perturbation.items()}


def beyond(original: Tensor, attacked: Tensor, limit: int) -> int:
    """The number of pixels with a channel that differs by more than `limit` 8-bit steps; images are uint8 [H, W, 3]."""
    moved = (attacked.to(torch.int16) - original.to(torch.int16)).abs()
    return int((moved > limit).any(dim=-1).sum())


def answer(logits: Tensor, labels: tuple[str, ...], goal: ResolvedGoal) -> Answer:
    """The answer that scores [K] give. On a tie the lower index is the answer, as in `ResolvedGoal.fooled`."""
    index = int(logits.argmax())
    order = logits.argsort(descending=True, stable=True)[:5].tolist()
    return Answer(
        label=labels[index],
        index=index,
        confidence=float(probability(logits, index)),
        goal_probability=float(goal.probability(logits)),
        top=[(labels[i], float(probability(logits, i))) for i in order],
    )


def goal_log_odds(logits: Tensor, goal: ResolvedGoal) -> float:
    """The log-odds of the goal's labels (those to leave, or the one to reach) given scores [K], in float64."""
    return float(log_odds(logits.double(), goal.labels))
