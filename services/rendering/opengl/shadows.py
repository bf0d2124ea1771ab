"""Which lights of a pass need shadow maps: those of its images that differ."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from services.errors import InvalidRequest
from services.scenes.description import Scene, Shadows

if TYPE_CHECKING:
    from services.rendering.opengl.camera import RenderPass

Array = NDArray[np.float64]

SIDES = 6
"""Maps of a light among the objects; others need one."""
MAX_IMAGE_BYTES = 2**30
"""Bytes that the maps of one image's lights may take, were all of them among the objects."""
MAX_PASS_BYTES = 2**29
"""Bytes that the maps of a pass of several images may take likewise."""


@dataclass(frozen=True)
class PassShadows:
    """The different lights of a pass's images, and how their shadows are drawn.

    lights [L, 4]: position and 1, or the unit vector towards the light and 0. radii [L]: lengths, or angles in radians.
    of: for each point light of each image, then each directional and each spot light, its number among these.
    resolution: texels a side of a map. samples: of each light.
    """

    lights: Array
    radii: Array
    of: NDArray[np.int64]
    resolution: int
    samples: int

    @property
    def keys(self) -> list[bytes]:
        """What tells the lights apart."""
        return [row.tobytes() for row in np.column_stack([self.lights, self.radii])]


def images_per_pass(scene: Scene) -> int:
    """The number of images whose shadow maps fit into the memory of one pass, at least 1."""
    return max(1, MAX_PASS_BYTES // max(1, _image_bytes(scene)))


def check_size(scene: Scene) -> None:
    """Raises InvalidRequest("scene.shadows.resolution") if an image's shadow maps would take more than
    MAX_IMAGE_BYTES."""
    size = _image_bytes(scene)
    if scene.shadows is not None and size > MAX_IMAGE_BYTES:
        raise InvalidRequest(
            "scene.shadows.resolution",
            f"shadow maps of {scene.shadows.resolution} texels a side may take {size / 2**30:.1f} GiB for the scene's "
            f"lights; at most {MAX_IMAGE_BYTES / 2**30:g} GiB",
        )


def _image_bytes(scene: Scene) -> int:
    lights = len(scene.lights.points) + len(scene.lights.directional) + len(scene.lights.spots)
    return 0 if scene.shadows is None else SIDES * lights * 4 * scene.shadows.resolution**2


def pass_shadows(lit: "RenderPass", shadows: Shadows) -> PassShadows | None:
    """The shadows of a pass; None if it has no lights."""
    kinds = [
        (lit.points[..., 1:4], 1.0, shadows.softness),
        (lit.directionals[..., 1:4], 0.0, shadows.angle),
        (lit.spots[..., 1:4], 1.0, shadows.softness),
    ]
    rows = [
        np.column_stack([places.reshape(-1, 3), np.full(places.size // 3, last), np.full(places.size // 3, radius)])
        for places, last, radius in kinds
    ]
    every = np.concatenate(rows) + 0.0  # never −0
    if not len(every):
        return None
    number: dict[bytes, int] = {}
    of = [number.setdefault(row.tobytes(), len(number)) for row in every]
    different = np.array([np.frombuffer(row) for row in number])
    samples = shadows.samples if different[:, 4].any() else 1
    return PassShadows(different[:, :4].copy(), different[:, 4].copy(), np.array(of), shadows.resolution, samples)
