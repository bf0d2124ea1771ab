"""The G-buffer: normals, coverage, base colour, depth and object numbers of each pixel, before any light.

Pixels in which surfaces meet have them apart (`Fragments`). An outline is the mean of their colours, not the colour of
a mean surface: the mean normal of an object and of the floor behind it is that of neither, and may catch a light that
neither does.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import cos, radians
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene_attack.errors import InvalidRequest
from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.opengl import context
from scene_attack.rendering.opengl.camera import CameraMatrices, Rectangle, rectangle
from scene_attack.scenes.mesh import Part
from scene_attack.scenes.resolve import ResolvedScene
from scene_attack.scenes.solids import has_holes

if TYPE_CHECKING:
    from scene_attack.rendering.opengl.mesh_upload import Drawing

SURFACES = 4
"""Maximum number of surfaces of a pixel; samples of further ones count with the surface that has most samples."""
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
        """Returns the same on a device."""
        return Fragments(**{name: value.to(device) for name, value in vars(self).items()})

    def some(self, entries: Tensor) -> "Fragments":
        """Returns the entries at the indices, int64, in their order."""
        return Fragments(**{name: value[entries] for name, value in vars(self).items()})

    @classmethod
    def joined(cls, parts: "list[Fragments]") -> "Fragments":
        """Returns the surfaces of several parts of an image, sorted by rank and then by pixel."""
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


FACTOR = 4
"""Samples per pixel in each direction: coverage in steps of 1/16."""

TILE = 256
"""Side, in pixels, of the square that is drawn at once: 1024 x 1024 samples of 36 bytes, whatever the size of the
image."""

THRESHOLDS = (np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]], np.float32).ravel() + 0.5) / 16
"""Ordered dither (Bayer 1973) over the samples of a pixel, for opacity."""


@dataclass(frozen=True)
class GBuffer:
    """Geometry and base colour of an image. OpenGL draws it on the CPU; `to` copies it elsewhere. Values mean
    nothing where `coverage` is 0 (they are 0).

    normals float32 [H, W, 3], unit, world space, on the viewer's side; coverage float32 [H, W] in [0,1]; base_color
    float32 [H, W, 3], linear; depth float32 [H, W], along the viewing direction, scene units; object_index int64 [H,
    W], -1 outside; backend names the driver and library versions. fragments: the surfaces of each pixel by themselves,
    in scenes with a floor or something fixed; None in others, where a pixel is shaded as its mean surface.
    """

    normals: Tensor
    coverage: Tensor
    base_color: Tensor
    depth: Tensor
    object_index: Tensor
    backend: str
    fragments: Fragments | None = None

    def to(self, device: torch.device) -> "GBuffer":
        """Returns the same on a device; itself where it is there already."""
        return replace(
            self,
            normals=self.normals.to(device),
            coverage=self.coverage.to(device),
            base_color=self.base_color.to(device),
            depth=self.depth.to(device),
            object_index=self.object_index.to(device),
            fragments=None if self.fragments is None else self.fragments.to(device),
        )

    def surfaces(self) -> Fragments:
        """The surfaces to shade: those of each covered pixel, or its mean surface where they are not apart."""
        return self.at((self.coverage.flatten() > 0).nonzero()[:, 0]) if self.fragments is None else self.fragments

    def at(self, pixels: Tensor) -> Fragments:
        """Returns the mean surfaces of pixels, by their flat indices [P]."""
        return Fragments(
            pixels=pixels,
            rank=torch.zeros_like(pixels),
            share=self.coverage.flatten()[pixels],
            normals=self.normals.reshape(-1, 3)[pixels],
            base_color=self.base_color.reshape(-1, 3)[pixels],
            depth=self.depth.flatten()[pixels],
            object_index=self.object_index.flatten()[pixels],
            place=torch.full((len(pixels), 2), 0.5, device=pixels.device),
        )


def rasterise(scene: ResolvedScene, drawing: "Drawing | None" = None) -> GBuffer:
    """Draw the scene's geometry, where the objects are, with 4x4 samples per pixel and average: coverage is the share
    of samples on an object; normal (renormalised) and base colour are means over those; the object is the one with most
    samples (the first of equals), the depth the mean of its samples.

    A part of opacity d < 1 is seen by about the share d of the samples and seen through by the others, so that it
    counts with its opacity in coverage, colour and normal; texels of less than half alpha are holes.

    `drawing` holds the scene's meshes, for a caller that draws many views of them: they are then uploaded once.

    What is fixed, and the floor, are more objects after the others.

    Raises InvalidRequest("scene.objects") when no pixel shows an object, or none but these.
    """
    current = context.current()
    from scene_attack.rendering.opengl.mesh_upload import Drawing

    height, width = scene.description.camera.size
    count = len(scene.placed)
    poses = np.asarray([placed.model for placed in scene.placed])
    view = CameraMatrices.of(scene.view, scene.projection)
    drawing = Drawing([placed.mesh for placed in scene.placed]) if drawing is None else drawing
    colors = np.array([placed.described.color for placed in scene.placed], np.float64)
    images = _nothing(height, width)
    apart: list[Fragments] = []
    numbers = torch.arange(height * width).reshape(height, width)
    covered = rectangle(drawing.points, list(view.clip_from_world @ poses), (height, width))
    for rows, columns in _tiles(covered):
        geometry, surface = current.renderer.draw(
            drawing,
            "gbuffer.frag",
            CameraMatrices(_crop(rows, columns, height, width) @ view.clip_from_world, view.eye, view.forward),
            poses,
            colors[None],
            {"forward": view.forward, "factor": FACTOR, "thresholds[0]": THRESHOLDS},
            {"object_number": [float(i + 1) for i in range(count)]},
            size=((rows.stop - rows.start) * FACTOR, (columns.stop - columns.start) * FACTOR),
            samples=1,
            outputs=2,
            blend=False,
        )
        samples = torch.from_numpy(geometry), torch.from_numpy(surface)
        means = average_samples(*samples, count, view.forward)
        for name, tile in means.items():
            images[name][rows, columns] = tile.flip(0)  # OpenGL's first row is the bottom one
        if len(scene.placed) > len(scene.meshes):
            apart.append(fragments(*samples, means, FACTOR, numbers[rows, columns].flip(0)))
    if not (images["object_index"].ge(0) & images["object_index"].lt(len(scene.meshes))).any():
        raise InvalidRequest("scene.objects", "out of view: no object covers any part of the image")
    surfaces = Fragments.joined(apart) if apart else None
    return GBuffer(**images, fragments=surfaces, backend=f"{current.backend}; {FACTOR}x{FACTOR} samples per pixel")


def check_in_view(scene: ResolvedScene) -> None:
    """Raises InvalidRequest("scene.objects"), as `rasterise` does, when no surface covers any part of the image.

    The scene's triangles are in the frame already. Surfaces that need not show all the same are drawn to find out: glTF
    surfaces that are seen from one side only or through a mask, surfaces with holes or of an opacity below 1, and
    objects that a floor or something fixed may hide.
    """
    parts = [part for mesh in scene.meshes for part in mesh.parts]
    if len(scene.placed) > len(scene.meshes) or not any(_shows(part) for part in parts):
        rasterise(scene)


def _shows(part: Part) -> bool:
    """Whether a part shows wherever a ray meets it."""
    material = part.metallic_roughness
    if material is not None:
        return material.solid
    return bool(part.color[3] >= 1) and not has_holes(part)


def _tiles(covered: Rectangle) -> Iterator[tuple[slice, slice]]:
    first_row, last_row, first_column, last_column = covered
    for top in range(first_row, last_row, TILE):
        for left in range(first_column, last_column, TILE):
            yield slice(top, min(top + TILE, last_row)), slice(left, min(left + TILE, last_column))


def _crop(rows: slice, columns: slice, height: int, width: int) -> NDArray[np.float64]:
    """The clip-space matrix that makes a part of the image fill the whole."""
    left, right = 2 * columns.start / width - 1, 2 * columns.stop / width - 1
    bottom, top = 1 - 2 * rows.stop / height, 1 - 2 * rows.start / height
    crop = np.eye(4)
    crop[0, 0], crop[0, 3] = 2 / (right - left), -(right + left) / (right - left)
    crop[1, 1], crop[1, 3] = 2 / (top - bottom), -(top + bottom) / (top - bottom)
    return crop


def average_samples(geometry: Tensor, surface: Tensor, count: int, forward: NDArray[np.float64]) -> dict[str, Tensor]:
    """Samples [h*FACTOR, w*FACTOR, 4] of `count` objects to pixels [h, w]."""
    images = (_averaged if compiled.runs(geometry) else _averaged_in_torch)(geometry, surface, count)
    seen = images["coverage"] > 0
    normal = images["normals"]
    length = normal.norm(dim=-1, keepdim=True)
    # Samples that face opposite ways cancel; such a pixel faces the viewer.
    facing = torch.from_numpy(-forward).float().expand_as(normal)
    alike = length > 1e-3 * FACTOR**2 * images["coverage"][..., None]
    images["normals"] = torch.where(alike, normal / length, facing) * seen[..., None]
    return images


def _nothing(height: int, width: int) -> dict[str, Tensor]:
    """Pixels [height, width] that show nothing."""
    return {
        "normals": torch.zeros(height, width, 3),
        "coverage": torch.zeros(height, width),
        "base_color": torch.zeros(height, width, 3),
        "depth": torch.zeros(height, width),
        "object_index": torch.full((height, width), -1, dtype=torch.int64),
    }


def _averaged(geometry: Tensor, surface: Tensor, count: int) -> dict[str, Tensor]:
    """Pixels [h, w], but for their normals, which are sums over their samples."""
    height, width = geometry.shape[0] // FACTOR, geometry.shape[1] // FACTOR
    images = _nothing(height, width)
    of = (height, width, FACTOR, count, geometry, surface, *images.values())
    compiled.call("average", geometry.dtype, *of, compiled.threads())
    return images


def _averaged_in_torch(geometry: Tensor, surface: Tensor, count: int) -> dict[str, Tensor]:
    def blocks(samples: Tensor) -> Tensor:
        h, w, channels = samples.shape[0] // FACTOR, samples.shape[1] // FACTOR, samples.shape[2]
        rows = samples.reshape(h, FACTOR, w * FACTOR, channels).sum(1)  # one axis at a time: 20 times faster than both
        return rows.reshape(h, w, FACTOR, channels).sum(2)

    number = surface[..., 3]
    owned = torch.stack([number == i + 1 for i in range(count)], dim=-1)
    votes = blocks(owned.float())
    covered = votes.sum(-1)
    winner = votes.argmax(-1, keepdim=True)
    depths = blocks(geometry[..., 3:] * owned)
    return {
        "normals": blocks(geometry[..., :3]),
        "coverage": covered / FACTOR**2,
        "base_color": blocks(surface[..., :3]) / covered.clamp_min(1)[..., None],
        "depth": (depths / votes.clamp_min(1)).gather(-1, winner)[..., 0],
        "object_index": torch.where(covered > 0, winner[..., 0], -1),
    }
