"""The surfaces that meet in a pixel, apart: an outline is the mean of their colours, not the colour of a mean surface.

The mean normal of an object and of the floor behind it is that of neither, and may catch a light that neither does.
"""

from dataclasses import dataclass
from math import cos, radians

import torch
from torch import Tensor

SURFACES = 4
"""Most surfaces of a pixel; what else there is counts with the one that has most samples."""
ALIKE = cos(radians(30))
"""Samples of one object are of one surface if the cosine of their normals is at least this: not on both sides of a
cube's edge."""


@dataclass(frozen=True)
class Fragments:
    """The surfaces of an image's covered pixels: for each pixel one or more entries, those of the largest share first.

    pixels int64 [F], flat indices of the pixels; rank int64 [F], 0 for the first entry of a pixel; share float32 [F],
    of the pixel's samples; normals float32 [F, 3], unit, world space, on the viewer's side; base_color float32 [F, 3];
    depth float32 [F]; object_index int64 [F]; place float32 [F, 2], the middle of its samples in the pixel, column and
    row from the upper left, in [0,1].
    """

    pixels: Tensor
    rank: Tensor
    share: Tensor
    normals: Tensor
    base_color: Tensor
    depth: Tensor
    object_index: Tensor
    place: Tensor

    def to(self, device: torch.device) -> "Fragments":
        """The same on a device."""
        return Fragments(**{name: value.to(device) for name, value in vars(self).items()})

    def some(self, entries: Tensor) -> "Fragments":
        """The entries of these indices, int64, in their order."""
        return Fragments(**{name: value[entries] for name, value in vars(self).items()})

    @classmethod
    def joined(cls, parts: "list[Fragments]") -> "Fragments":
        """Those of several parts of an image, sorted by rank and then by pixel."""
        whole = cls(**{name: torch.cat([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__})
        order = torch.argsort(whole.rank * (int(whole.pixels.amax()) + 1) + whole.pixels)
        return whole.some(order)


def fragments(geometry: Tensor, surface: Tensor, means: dict[str, Tensor], factor: int, numbers: Tensor) -> Fragments:
    """Groups the samples of a tile, in OpenGL's order of rows.

    geometry [h·factor, w·factor, 4]: normal and depth; surface, of the same shape: colour and the object's number from
    1, or 0. `means` [h, w] are the pixels as `average_samples` returns them, which pixels of one surface keep.
    `numbers` int64 [h, w] are the flat indices of the pixels in the image.
    """
    number = _samples(surface[..., 3:], factor)[..., 0]
    covered = number > 0
    several = number.amax(-1) != torch.where(covered, number, torch.inf).amin(-1)
    normals = _samples(geometry[..., :3], factor)
    bent = (normals.amax(-2) - normals.amin(-2)).amax(-1) > 1 - ALIKE  # any two that are not alike differ by more
    mixed = covered.any(-1) & (several | bent)
    single = covered.any(-1) & ~mixed
    alone = Fragments(
        pixels=numbers[single],
        rank=torch.zeros(int(single.sum()), dtype=torch.int64),
        share=means["coverage"][single],
        normals=means["normals"][single],
        base_color=means["base_color"][single],
        depth=means["depth"][single],
        object_index=means["object_index"][single],
        place=torch.full((int(single.sum()), 2), 0.5),
    )
    depth, color = _samples(geometry[..., 3:], factor)[mixed][..., 0], _samples(surface[..., :3], factor)[mixed]
    return Fragments.joined([alone, _grouped(number[mixed], normals[mixed], depth, color, factor, numbers[mixed])])


def _samples(image: Tensor, factor: int) -> Tensor:
    """Returns the samples of each pixel, [h, w, factor², channels]."""
    height, width, channels = image.shape[0] // factor, image.shape[1] // factor, image.shape[2]
    blocks = image.reshape(height, factor, width, factor, channels).permute(0, 2, 1, 3, 4)
    return blocks.reshape(height, width, factor**2, channels)


def _grouped(number: Tensor, normals: Tensor, depth: Tensor, color: Tensor, factor: int, pixels: Tensor) -> Fragments:
    """Groups the samples [P, S] of pixels by object and normal, each with the first sample that it is like."""
    count, samples = number.shape
    group = torch.full((count, samples), -1)
    for k in range(SURFACES):
        left = (group < 0) & (number > 0)
        first = left.to(torch.int8).argmax(1, keepdim=True)
        seed = normals.gather(1, first[..., None].expand(-1, -1, 3))
        same = (number == number.gather(1, first)) & ((normals * seed).sum(-1) >= ALIKE * seed.norm(dim=-1))
        group = torch.where(left & same, k, group)
    members = torch.stack([group == k for k in range(SURFACES)], dim=1).float()  # [P, groups, S]
    sizes = members.sum(-1)
    order = sizes.argsort(dim=1, descending=True, stable=True)
    members, sizes = members.gather(1, order[..., None].expand(-1, -1, samples)), sizes.gather(1, order)
    shares = sizes / samples
    shares[:, 0] += ((group < 0) & (number > 0)).sum(1) / samples
    kept = sizes > 0
    each = members / sizes.clamp_min(1)[..., None]
    middles = (torch.arange(factor) + 0.5) / factor
    along, across = torch.meshgrid(middles, middles, indexing="ij")
    places = torch.stack((across.flatten(), 1 - along.flatten()), dim=-1)  # OpenGL's first row is the bottom one
    means = each @ normals
    own = number.gather(1, members.argmax(-1))
    return Fragments(
        pixels=pixels[:, None].expand_as(kept)[kept],
        rank=torch.arange(SURFACES).expand_as(kept)[kept],
        share=shares[kept],
        normals=torch.nn.functional.normalize(means[kept], dim=-1),
        base_color=(each @ color)[kept],
        depth=(each @ depth[..., None])[..., 0][kept],
        object_index=own[kept].long() - 1,
        place=(each @ places)[kept],
    )
