"""Shades batches of views, each with a look, a ground, a tint and a crop of its own, and distorts their images, so that
a network learns shapes and not the models it is shown.
"""

from dataclasses import dataclass, replace
from functools import cache
from math import radians

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from scene_attack.rendering.color import to_display
from scene_attack.scenes.description import GROUND
from training.views import GRID, Views

MEAN, SCALE = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""torchvision's normalisation of images for networks trained on ImageNet."""
CURVE = 4096
"""Entries of the table of the sRGB curve."""
TINTED, PAINTED = 0.35, 0.3
"""Shares of the views whose base colour is tinted, and whose object has one random colour all over."""
DEFAULT_GROUND = 0.25
"""Share of the views that stand on the default ground."""


@dataclass(frozen=True)
class Choices:
    """Random choices that differ between the images of a batch.

    views, looks: int64 [B]. grounds: float32 [B, 3], displayed, multiples of 1/255. tints: float32 [B, 3], factors on
    the linear base colour. painted: bool [B], whether the tint is the base colour, in the place of the model's own.
    shifts: int64 [B, 2], rows and columns from the middle. mirrored: bool [B].
    """

    views: NDArray[np.int64]
    looks: NDArray[np.int64]
    grounds: NDArray[np.float32]
    tints: NDArray[np.float32]
    painted: NDArray[np.bool_]
    shifts: NDArray[np.int64]
    mirrored: NDArray[np.bool_]


def plain(views: NDArray[np.int64], looks: NDArray[np.int64]) -> Choices:
    """Returns choices that change nothing: default ground, no tint, the middle of the view."""
    count = len(views)
    return Choices(
        views,
        looks,
        np.full((count, 3), GROUND, np.float32),
        np.ones((count, 3), np.float32),
        np.zeros(count, np.bool_),
        np.zeros((count, 2), np.int64),
        np.zeros(count, np.bool_),
    )


def as_in_default_scene(views: Views, chosen: NDArray[np.int64], n_looks: int, random: np.random.Generator) -> Choices:
    """Returns random choices of look, place and mirror image; ground and colours are the default scene's."""
    look = random.integers(0, n_looks, len(chosen))
    return replace(plain(chosen, look), shifts=_shifts(views, len(chosen), random), mirrored=_coins(chosen, random))


def augmented(views: Views, chosen: NDArray[np.int64], n_looks: int, random: np.random.Generator) -> Choices:
    """Returns random choices for the `chosen` of some views."""
    count = len(chosen)
    gray = random.integers(40, 226, (count, 1)).repeat(3, 1)
    coloured = random.integers(30, 226, (count, 3))
    kind = random.random((count, 1))
    grounds = np.where(kind < DEFAULT_GROUND, round(GROUND * 255), np.where(kind < 0.75, gray, coloured))
    painted = random.random(count) < PAINTED
    tinted = (random.random(count) < TINTED) | painted
    bright, hue = random.uniform(0.1, 1.0, (count, 1)), random.uniform(0.3, 1.0, (count, 3))
    tints = np.where(tinted[:, None], np.where(painted[:, None], bright, 1.0) * hue, 1.0)
    return Choices(
        chosen,
        random.integers(0, n_looks, count),
        (grounds / 255).astype(np.float32),
        tints.astype(np.float32),
        painted,
        _shifts(views, count, random),
        _coins(chosen, random),
    )


def shade(views: Views, tables: Tensor, choices: Choices) -> Tensor:
    """Returns images [B, 3, size, size] of views, displayed values in [0,1], channels last.

    `tables` are looks [T, GRID², 6].
    """
    size = views.size
    at, image = _gathered(views, choices.views)
    row, column = np.divmod(views.pixels[at].astype(np.int64), views.side)
    offset = (views.side - size) // 2 + choices.shifts
    row, column = row - offset[image, 0], column - offset[image, 1]
    column = np.where(choices.mirrored[image], size - 1 - column, column)
    inside = (row >= 0) & (row < size) & (column >= 0) & (column < size)
    at, image, row, column = at[inside], image[inside], row[inside], column[inside]

    owner = torch.from_numpy(image)
    look = torch.from_numpy(choices.looks)[owner]
    light = tables.flatten(0, 1)[look * GRID**2 + torch.from_numpy(views.normals[at].astype(np.int64))]
    base = (torch.from_numpy(views.colors[at]).float() / 255).square_()
    base[torch.from_numpy(choices.painted)[owner]] = 1.0
    base *= torch.from_numpy(choices.tints)[owner]
    linear = torch.addcmul(light[:, 3:], base, light[:, :3])
    shown = _curve()[(linear.clamp_(0, 1) * (CURVE - 1)).round_().long()]
    coverage = torch.from_numpy(views.coverage[at]).float()[:, None] / 255
    grounds = torch.from_numpy(choices.grounds)
    images = grounds[:, None].expand(-1, size * size, -1).contiguous()
    place = owner * (size * size) + torch.from_numpy(row * size + column)
    images.view(-1, 3)[place] = torch.lerp(grounds[owner], shown, coverage)
    return images.view(-1, size, size, 3).permute(0, 3, 1, 2)


def normalised(images: Tensor) -> Tensor:
    """Returns images [B, 3, h, w] in [0,1] as the network takes them."""
    mean, scale = (torch.tensor(values).view(1, 3, 1, 1) for values in (MEAN, SCALE))
    return (images - mean) / scale


def _gathered(views: Views, chosen: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Returns the indices of the chosen views' pixels, and the place in the batch of each."""
    starts, ends = views.starts[chosen], views.starts[chosen + 1]
    image = np.repeat(np.arange(len(chosen)), ends - starts)
    at = np.concatenate([np.arange(a, b) for a, b in zip(starts, ends, strict=True)])
    return at, image


def _shifts(views: Views, count: int, random: np.random.Generator) -> NDArray[np.int64]:
    furthest = (views.side - views.size) // 2
    return random.integers(-furthest, furthest + 1, (count, 2))


def _coins(chosen: NDArray[np.int64], random: np.random.Generator) -> NDArray[np.bool_]:
    return random.random(len(chosen)) < 0.5


@cache
def _curve() -> Tensor:
    return to_display(torch.linspace(0, 1, CURVE, dtype=torch.float64)).float()


TURN = radians(12)
"""Largest turn in the image plane."""
LARGEST, SMALLEST = 1.12, 0.72
"""Range of the size relative to the view's."""
STRETCH = 0.2
"""Largest natural logarithm of the ratio of width to height."""
SHEAR = 0.15
SHIFT = 0.12
"""Largest shift, in halves of the image's side."""
ERASED = 0.3
"""Share of the images of which a rectangle is painted over."""


def distort(images: Tensor, random: np.random.Generator, strength: float = 1.0) -> Tensor:
    """Returns images [B, 3, h, w], each turned, scaled, stretched, sheared and shifted at random, some partly hidden.

    `strength` in [0, 1] scales every range, and the share that is partly hidden. What comes in from outside has the
    colour of the nearest edge, which is the ground's unless the object reaches it.
    """
    count = len(images)
    turn, shear = strength * random.uniform(-TURN, TURN, count), strength * random.uniform(-SHEAR, SHEAR, count)
    size = np.exp(strength * random.uniform(np.log(SMALLEST), np.log(LARGEST), count))
    stretch = np.exp(strength * random.uniform(-STRETCH, STRETCH, count) / 2)
    cos, sin = np.cos(turn) / size, np.sin(turn) / size
    # From a place in the result to one in the image: scale and turn, then shear, then stretch.
    matrices = np.stack([np.stack([cos, shear * cos - sin], -1), np.stack([sin, shear * sin + cos], -1)], 1)
    matrices *= np.stack([stretch, 1 / stretch], -1)[:, None]
    shifts = strength * random.uniform(-SHIFT, SHIFT, (count, 2, 1))
    maps = torch.from_numpy(np.concatenate([matrices, shifts], axis=2)).float()
    grid = F.affine_grid(maps, list(images.shape), align_corners=False)
    distorted = F.grid_sample(images, grid, padding_mode="border", align_corners=False)
    return _erased(distorted.contiguous(memory_format=torch.channels_last), strength * ERASED, random)


def _erased(images: Tensor, share: float, random: np.random.Generator) -> Tensor:
    height, width = images.shape[-2:]
    for image in images:
        if random.random() >= share:
            continue
        h, w = (int(side * random.uniform(0.15, 0.45)) for side in (height, width))
        top, left = random.integers(0, height - h + 1), random.integers(0, width - w + 1)
        colour = torch.from_numpy(random.random(3)).float()
        image[:, top : top + h, left : left + w] = colour[:, None, None]
    return images
