"""Radiance of a pass over the geometry, drawn by OpenGL."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from services.rendering.opengl import context
from services.rendering.opengl.camera import RenderPass
from services.rendering.opengl.shadows import pass_shadows
from services.rendering.pyrender_renderer.rasteriser import SAMPLES

if TYPE_CHECKING:
    from services.rendering.opengl.mesh_upload import Drawing
    from services.rendering.opengl.render_pass import Backfaces

MAX_BACKFACE_MISMATCH = 0.01
"""Largest share of covered pixels that the backfaces of watertight surfaces may change. At silhouettes depths of both
sides round to the same number; a surface that passes through itself changes more and is not taken for watertight."""


def draw(drawing: "Drawing", lit: RenderPass, size: tuple[int, int], backfaces: "Backfaces") -> NDArray[np.float32]:
    """The radiance [images, rows, columns, 4] of the pass's part, the bottom row first.

    `size` is the height and width of the whole image; `backfaces` says what is done with those of watertight surfaces.
    """
    images: NDArray[np.float32] = context.current().renderer.draw(
        drawing,
        "radiance.frag",
        lit.view,
        lit.poses,
        lit.colors,
        lit.uniforms,
        {},
        size=size,
        samples=SAMPLES,
        outputs=len(lit.colors),
        blend=True,
        lights=lit.light_counts,
        rectangle=lit.part,
        backfaces=backfaces,
        shadows=None if lit.shadows is None else pass_shadows(lit, lit.shadows),
    )
    return images


def looks_watertight(natural: NDArray[np.float32], outside: NDArray[np.float32]) -> bool:
    """Whether the backfaces of watertight surfaces show nowhere: the first of two images [..., 4] has them. Radiance
    is on the scale of the display, and coverage is last.
    """
    changed = np.abs(outside - natural).max(axis=-1) > 1 / 255
    return bool(changed.sum() <= MAX_BACKFACE_MISMATCH * (natural[..., 3] > 0).sum())
