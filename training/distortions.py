"""Distorts images of a batch, so that a network learns shapes and not the models it is shown."""

from math import radians

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

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
