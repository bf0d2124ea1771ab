"""Trains the trunk to find objects' centres and attributes in its features; the heads for it are then thrown away.

The places and attributes of objects are known in rendered scenes, and every question depends on them alone.
The trunk is shown some images mirrored, and all of them brighter or darker and tinted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from scene_attack.rendering.color import from_bytes
from scene_attack_questions.clevr.records import ATTRIBUTES
from scene_attack_questions.iep.engine import CHANNELS, GRID, IMAGE, STRIDE, Engine, Trunk
from training.iep.data import Images
from training.iep.engine_training import mask_loss, occupancy
from training.iep.examples import ObjectTruth

VALUES = tuple(value for values in ATTRIBUTES.values() for value in values)
PLACE_WEIGHT = 1.0
"""Weight of the loss on a centre's place in its cell."""
HEAT_WEIGHT = 10.0
"""Weight of the loss on the cells of centres: a mean over all cells, of which few matter."""


class ObjectFinder(nn.Module):
    """The trunk with a linear head: scores of a centre and of each attribute's values, and the place of the centre."""

    def __init__(self) -> None:
        super().__init__()
        self.trunk = Trunk()
        self.head = nn.Conv1d(CHANNELS, 1 + len(VALUES) + 2, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Maps images [B, 240, 320, 3] in [0,1] to [B, 300, 18], in the order of the class's description."""
        scores: Tensor = self.head(self.trunk(images).flatten(2)).transpose(1, 2)
        return scores


def hand_over(finder: ObjectFinder, engine: Engine) -> None:
    """Makes the finder's scores of a centre the engine's first mask of all objects, so that it sees them at once."""
    with torch.no_grad():
        engine.stem.mask.weight.copy_(finder.head.weight[:1])
        assert engine.stem.mask.bias is not None
        assert finder.head.bias is not None
        engine.stem.mask.bias.copy_(finder.head.bias[:1])


@dataclass(frozen=True)
class Truth:
    """The objects of a batch of images.

    centres: float32 [B, 300], 1 where there is one. images, cells: int64 [N], of each object. values: int64 [N, 4], the
    index of each attribute's value. places: float32 [N, 2], of the centre in its cell, in [-1/2, 1/2].
    """

    centres: Tensor
    images: Tensor
    cells: Tensor
    values: Tensor
    places: Tensor

    @classmethod
    def of(cls, objects: Sequence[Sequence[ObjectTruth]]) -> "Truth":
        """The objects of each image, one at least in all."""
        every = [(image, solid) for image, of_image in enumerate(objects) for solid in of_image]
        values = [[ATTRIBUTES[name].index(solid.attributes[name]) for name in ATTRIBUTES] for _, solid in every]
        width = GRID[1]
        places = [
            (solid.row / STRIDE - solid.cell // width - 0.5, solid.column / STRIDE - solid.cell % width - 0.5)
            for _, solid in every
        ]
        return cls(
            occupancy([[solid.cell for solid in of_image] for of_image in objects], torch.zeros(())),
            torch.tensor([image for image, _ in every]),
            torch.tensor([solid.cell for _, solid in every]),
            torch.tensor(values),
            torch.tensor(places).clamp(-0.5, 0.5),
        )


def trunk_loss(found: Tensor, truth: Truth) -> tuple[Tensor, dict[str, float]]:
    """Returns the loss of the scores `found` [B, 300, 18], and its parts."""
    there = found[truth.images, truth.cells]
    attributes = sum(
        F.cross_entropy(scores, truth.values[:, place]) for place, scores in enumerate(_by_attribute(there))
    )
    heat = mask_loss(found[:, :, 0], truth.centres)
    place = F.smooth_l1_loss(there[:, 1 + len(VALUES) :], truth.places, beta=0.1)
    assert isinstance(attributes, Tensor)
    parts = {"heat": heat, "attributes": attributes, "place": place}
    total = HEAT_WEIGHT * heat + attributes + PLACE_WEIGHT * place
    return total, {name: float(value.detach()) for name, value in parts.items()}


def trunk_accuracy(found: Tensor, truth: Truth) -> dict[str, float]:
    """Returns the share of objects with each attribute right, with all right, and the share of cells of centres that
    are among the highest of their image, of as many as there are objects.
    """
    there = found[truth.images, truth.cells]
    right = {
        name: scores.argmax(1) == truth.values[:, place]
        for place, (name, scores) in enumerate(zip(ATTRIBUTES, _by_attribute(there), strict=True))
    }
    order = found[:, :, 0].argsort(1, descending=True).argsort(1)
    counts = truth.centres.sum(1)
    return {
        **{name: float(of.double().mean()) for name, of in right.items()},
        "all": float(torch.stack(list(right.values())).all(0).double().mean()),
        "found": float((order[truth.images, truth.cells] < counts[truth.images]).double().mean()),
    }


Views = Callable[[NDArray[np.int64], np.random.Generator], tuple[Tensor, Sequence[Sequence[ObjectTruth]]]]
"""Returns images of some scenes, [B, 240, 320, 3] in [0,1], and their objects; it may change both at random."""


def trunk_step(
    module: ObjectFinder, views: Views, n_scenes: int, batch: int
) -> Callable[[float, np.random.Generator], tuple[Tensor, dict[str, float]]]:
    """Returns the step of a training loop on `n_scenes` scenes."""

    def step(_: float, random: np.random.Generator) -> tuple[Tensor, dict[str, float]]:
        images, objects = views(random.choice(n_scenes, min(batch, n_scenes), replace=False), random)
        with torch.autocast(images.device.type, dtype=torch.bfloat16):
            scores = module(images)
        return trunk_loss(scores.float(), Truth.of(objects))

    return step


def _by_attribute(there: Tensor) -> list[Tensor]:
    """Returns the scores of each attribute's values, from rows of all 18."""
    ends = np.cumsum([1, *(len(values) for values in ATTRIBUTES.values())]).tolist()
    return [there[:, start:end] for start, end in pairwise(ends)]


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
    return [replace(solid, column=IMAGE[1] - solid.column) for solid in objects]
