"""Draws views of library meshes once and keeps the inputs of a view's shading.

A view is drawn `MARGIN` times as large as the images made of it and keeps the field of view of the scene's camera in
its middle, so that a random crop of it is a view with the object moved by a few pixels.
"""

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import atan, pi, tan
from pathlib import Path

import numpy as np
import safetensors.numpy
import torch
from numpy.typing import NDArray
from torch import Tensor

from scene_attack import disk
from scene_attack.rendering.opengl.gbuffer import GBuffer, rasterise
from scene_attack.scenes.description import DISTANCE, ELEVATION, FIELD_OF_VIEW, Camera, Scene, SceneObject
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack.scenes.resolve import resolve
from scene_attack.scenes.view import camera_to_world, projection

MARGIN = (8, 7)
"""Side of a drawn view to side of its images."""
INPUT = 112
"""Side of the trained networks' input, pixels: half a view of 224, as the paper's networks see half of 448."""
GRID = 128
"""Rows and columns of the grid of normals, an equal-area map of the hemisphere that faces the viewer."""
VERSION = 1


@dataclass(frozen=True)
class Views:
    """The covered pixels of some views of one size, one view after the other.

    side: of the drawn views, pixels. starts: int64 [V + 1], where each view's pixels begin. pixels: uint16 [P], row
    · side + column. normals: uint16 [P], nodes of the grid of normals in the camera's frame. colors: uint8 [P, 3],
    linear base colour's square root. coverage: uint8 [P].
    """

    side: int
    starts: NDArray[np.int64]
    pixels: NDArray[np.uint16]
    normals: NDArray[np.uint16]
    colors: NDArray[np.uint8]
    coverage: NDArray[np.uint8]

    @property
    def count(self) -> int:
        """Number of views."""
        return len(self.starts) - 1

    @property
    def size(self) -> int:
        """Side of the images made of the views, pixels."""
        return self.side * MARGIN[1] // MARGIN[0]


def training_cameras(mesh: str, count: int, seed: int, size: int) -> list[Camera]:
    """Returns cameras around the object: azimuths spread evenly and jittered, elevation and distance near the paper's.

    They depend on the mesh's name, the count and the seed only. `size` is the side of the images, pixels.
    """
    random = np.random.default_rng([seed, *hashlib.sha256(mesh.encode()).digest()])
    turn = random.random() * 2 * pi
    return [
        _camera(
            azimuth=(turn + 2 * pi * (k + random.uniform(-0.5, 0.5)) / count) % (2 * pi),
            elevation=ELEVATION + random.uniform(-0.17, 0.17),
            distance=DISTANCE * random.uniform(0.9, 1.2),
            size=size,
        )
        for k in range(count)
    ]


def paper_cameras(count: int, size: int) -> list[Camera]:
    """Returns cameras at the paper's elevation and distance, their azimuths spread evenly from the default one."""
    return [_camera((0.61 + 2 * pi * k / count) % (2 * pi), ELEVATION, DISTANCE, size) for k in range(count)]


def views(library: Library, mesh: str, cameras: Sequence[Camera], folder: Path) -> Views:
    """Returns the views of a mesh, drawn if `folder` does not hold them yet.

    Raises the errors of loading the mesh, and InvalidRequest where it covers no pixel of a view.
    """
    named = json.dumps([VERSION, GRID, mesh, [camera.model_dump(mode="json") for camera in cameras]])
    path = folder / f"{hashlib.sha256(named.encode()).hexdigest()[:32]}.safetensors"
    if path.exists():
        return _read(path)
    drawn = joined([_packed(*view) for view in _draw(library, mesh, cameras)])
    arrays = {name: getattr(drawn, name) for name in _ARRAYS} | {"side": np.array(drawn.side)}
    disk.write(path, safetensors.numpy.save(arrays))
    return drawn


def joined(parts: Sequence[Views]) -> Views:
    """Puts views of one size behind each other."""
    offsets = np.cumsum([0, *(part.starts[-1] for part in parts)])
    starts = [part.starts[:-1] + offset for part, offset in zip(parts, offsets[:-1], strict=True)]
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in _ARRAYS[1:]}
    return Views(side=parts[0].side, starts=np.concatenate([*starts, offsets[-1:]]), **arrays)


def node_normals() -> Tensor:
    """Returns the unit normals [GRID², 3] of the grid's nodes in the camera's frame; beyond the rim, of the rim."""
    at = (torch.arange(GRID, dtype=torch.float64) + 0.5) * (2 / GRID) - 1
    v, u = torch.meshgrid(at, at, indexing="ij")
    radius = torch.hypot(u, v).clamp_min(1e-9)
    z = 1 - radius.clamp_max(1.0) ** 2
    across = (1 - z * z).sqrt() / radius
    return torch.stack((u * across, v * across, z), -1).reshape(-1, 3)


def nodes(normals: Tensor) -> Tensor:
    """Returns the grid's nearest nodes [...] to unit normals [..., 3] in the camera's frame, int64."""
    x, y, z = normals.unbind(-1)
    scale = (1 - z.clamp(0.0, 1.0)).sqrt() / torch.hypot(x, y).clamp_min(1e-9)
    column, row = (((w * scale + 1) * (GRID / 2)).long().clamp(0, GRID - 1) for w in (x, y))
    return row * GRID + column


_ARRAYS = ("starts", "pixels", "normals", "colors", "coverage")


def _camera(azimuth: float, elevation: float, distance: float, size: int) -> Camera:
    more, less = MARGIN
    side, wide = size * more // less, 2 * atan(tan(FIELD_OF_VIEW / 2) * more / less)
    return Camera(azimuth=azimuth, elevation=elevation, distance=distance, field_of_view=wide, size=(side, side))


def _draw(library: Library, mesh: str, cameras: Sequence[Camera]) -> Iterable[tuple[GBuffer, Tensor]]:
    """Yields each view's G-buffer, and the matrix [3, 3] that turns world vectors, as rows, to its camera's frame."""
    from scene_attack.rendering.opengl import context

    context.current()
    from scene_attack.rendering.opengl.mesh_upload import Drawing

    scene = resolve(Scene(objects=(SceneObject(mesh=mesh),), camera=cameras[0]), library)
    drawing = Drawing(scene.meshes)
    for camera in cameras:
        pose = camera_to_world(camera)
        lens = projection(camera, 2 * (camera.distance + FIT_RADIUS) + 10)
        seen = replace(
            scene, description=scene.description.model_copy(update={"camera": camera}), view=pose, projection=lens
        )
        yield rasterise(seen, drawing), torch.from_numpy(pose[:3, :3])


def _packed(gbuffer: GBuffer, to_camera: Tensor) -> Views:
    share = (gbuffer.coverage.flatten() * 255).round()
    at = share.nonzero()[:, 0]
    normals = gbuffer.normals.reshape(-1, 3)[at].double() @ to_camera
    colors = gbuffer.base_color.reshape(-1, 3)[at]
    return Views(
        side=gbuffer.coverage.shape[-1],
        starts=np.array([0, len(at)], np.int64),
        pixels=at.numpy().astype(np.uint16),
        normals=nodes(normals).numpy().astype(np.uint16),
        colors=(colors.clamp(0, 1).sqrt() * 255).round().numpy().astype(np.uint8),
        coverage=share[at].numpy().astype(np.uint8),
    )


def _read(path: Path) -> Views:
    arrays = safetensors.numpy.load_file(path)
    return Views(int(arrays["side"]), *(arrays[name] for name in _ARRAYS))
