"""Chooses the images of a batch that share a pass over the geometry, and those that share their channels."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GEOMETRY = ("camera", "translation", "rotation")
"""The groups that say where things are in the image."""


@dataclass(frozen=True)
class SharedPass:
    """Images of the same poses and camera, to be drawn at once, and the assignment of their channels to the images of
    the batch.

    camera [4]; translation, rotation [objects, 3]; illuminations [images, 1 + 4 points]; colors [images, objects, 3];
    users: (row of the batch, channel, image here).
    """

    camera: Array
    translation: Array
    rotation: Array
    illuminations: Array
    colors: Array
    users: list[tuple[int, int, int]]


def shared(batch: Mapping[str, Array], most: int) -> Iterator[SharedPass]:
    """Yields passes of at most `most` images each that draw a batch {group: [B, ...]}.

    A colour factor touches one channel of light. So images of the same camera, poses and lights are drawn with the
    first red, the first green and the first blue that any of them has, then with the second of each, and so on: the six
    sides of the differences of one object's colour, and the image they are around, take three images.
    """
    count = len(batch["color"])
    poses: dict[bytes, list[int]] = {}
    for row in range(count):
        poses.setdefault(_key(*(batch[group][row] for group in GEOMETRY)), []).append(row)
    for rows in poses.values():
        lit: dict[bytes, list[int]] = {}
        for row in rows:
            lit.setdefault(_key(batch["illumination"][row]), []).append(row)
        illuminations: list[Array] = []
        colors: list[Array] = []
        users: list[tuple[int, int, int]] = []
        for alike in lit.values():
            first = len(colors)
            for channel in range(3):
                slots: dict[bytes, int] = {}
                for row in alike:
                    column = batch["color"][row][:, channel]
                    slot = slots.setdefault(_key(column), first + len(slots))
                    if slot == len(colors):
                        colors.append(batch["color"][row].copy())
                        illuminations.append(batch["illumination"][row])
                    colors[slot][:, channel] = column
                    users.append((row, channel, slot))
        for start in range(0, len(colors), most):
            stop = min(start + most, len(colors))
            yield SharedPass(
                batch["camera"][rows[0]],
                batch["translation"][rows[0]],
                batch["rotation"][rows[0]],
                np.stack(illuminations[start:stop]),
                np.stack(colors[start:stop]),
                [(row, channel, slot - start) for row, channel, slot in users if start <= slot < stop],
            )


def alone(batch: Mapping[str, Array]) -> Iterator[SharedPass]:
    """Yields a pass for every image."""
    for row in range(len(batch["color"])):
        parameters = {group: values[row : row + 1] for group, values in batch.items()}
        users = [(row, channel, 0) for channel in range(3)]
        camera, translation, rotation = parameters["camera"][0], parameters["translation"][0], parameters["rotation"][0]
        yield SharedPass(camera, translation, rotation, parameters["illumination"], parameters["color"], users)


def fill(images: NDArray[np.float32], drawn: SharedPass, shown: NDArray[np.float32]) -> None:
    """Writes the images that a pass has drawn, `shown` [images of the pass, rows, columns, C], to the images of the
    batch that use them: `images` [B, rows, columns, C], of which the pass may fill some channels only.
    """
    channels = Counter((row, slot) for row, _, slot in drawn.users)
    for row, channel, slot in drawn.users:
        if channels[row, slot] == 3:
            if channel == 0:  # all at once
                images[row] = shown[slot]
        else:  # the others may be of another pass
            images[row, ..., channel] = shown[slot, ..., channel]
            if channel == 0:  # coverage is the same in all
                images[row, ..., 3:] = shown[slot, ..., 3:]


def _key(*values: Array) -> bytes:
    return b"".join(np.ascontiguousarray(value).tobytes() for value in values)
