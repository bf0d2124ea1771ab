"""Images of scenes as the trunk is shown them: some mirrored, all of them brighter or darker and tinted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from services.rendering.color import from_bytes
from services.targets.iep.engine import IMAGE
from training.iep.data import Images
from training.iep.examples import ObjectTruth

BRIGHTER, TINTED = 0.1, 0.03
"""Standard deviations of the logarithms of an image's factor and of each channel's."""


class AugmentedViews:
    """The images of scenes and their objects, changed at random; the truth stays true."""

    def __init__(self, images: Images, objects: Sequence[Sequence[ObjectTruth]]) -> None:
        self._images, self._objects = images, objects

    def __call__(
        self, chosen: NDArray[np.int64], random: np.random.Generator
    ) -> tuple[Tensor, list[Sequence[ObjectTruth]]]:
        """Returns images [B, 240, 320, 3] in [0,1] of the chosen scenes, and the objects of each."""
        images, objects = from_bytes(torch.from_numpy(self._images(chosen))), [self._objects[k] for k in chosen]
        for place in np.flatnonzero(random.random(len(chosen)) < 0.5):
            images[place] = images[place].flip(1)
            objects[place] = mirrored(objects[place])
        brighter, tinted = (random.standard_normal((len(chosen), count)) for count in (1, 3))
        factors = torch.from_numpy(np.exp(BRIGHTER * brighter + TINTED * tinted)).float()
        return images.mul_(factors[:, None, None]).clamp_(0, 1), objects


def mirrored(objects: Sequence[ObjectTruth]) -> list[ObjectTruth]:
    """Returns the objects of an image whose left and right are exchanged."""
    return [replace(one, column=IMAGE[1] - one.column) for one in objects]
