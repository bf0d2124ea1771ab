"""What the pyrender renderer's plan says of shadows: which objects are in the maps, and what the maps leave out."""

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from services.rendering.opengl.camera import RenderPass
from services.rendering.opengl.shadow_views import box_corners, casters, shadow_views
from services.rendering.opengl.shadows import pass_shadows
from services.rendering.plan import Item, Plan, Stage
from services.rendering.pyrender_renderer.parameters import FINER

if TYPE_CHECKING:
    from services.rendering.opengl.mesh_upload import Drawing


def with_shadows(plan: Plan, drawing: "Drawing", lit: RenderPass, error: float) -> Plan:
    """A plan with the lines on shadows; as it is if there are none. `lit` is the scene's own image, and `error` that of
    `shadow_error`.
    """
    shadows = lit.shadows
    of_lights = None if shadows is None else pass_shadows(lit, shadows)
    if shadows is None or of_lights is None:
        return plan
    own, plain = box_corners(drawing.points)
    corners = [points @ pose[:3, :3].T + pose[:3, 3] for points, pose in zip(own, lit.poses, strict=True)]
    casting = [casters(corners, plain, light) for light in of_lights.lights]
    maps = sum(
        len(shadow_views([corners[k] for k in kept], light))
        for kept, light in zip(casting, of_lights.lights, strict=True)
    )
    texels = shadows.resolution**2
    item = Item(
        what="shadow casters",
        kept=sum(map(len, casting)),
        of=len(corners) * len(casting),
        why="objects times lights; the others are boxes with the light and all other objects before one of their sides",
    )
    stage = Stage(
        name="shadow maps",
        method=f"{maps} maps of {shadows.resolution} × {shadows.resolution} texels for {len(of_lights.lights)} lights, "
        f"{of_lights.samples} samples of each",
        when="every image",
        evaluations=maps * texels,
        unit="texels",
        why="the exact image has the same maps, so this costs it no error; maps and samples each "
        f"{FINER**2} times as many change displayed values by {error:.1e} in the mean over covered pixels; images of "
        "one pass share the maps of lights that agree, and maps stay until an object moves",
    )
    return plan.model_copy(update={"items": (*plan.items, item), "stages": (*plan.stages, stage)})


def shadow_error(image: Tensor, finer: Tensor, covered: Tensor) -> float:
    """The mean difference of displayed values between the scene's own image [H, W, 3] and that with finer shadow maps,
    over the pixels that are `covered` [H, W]; 0 if none is."""
    off = (image - finer).abs().mean(dim=-1)
    return float(off[covered].double().mean()) if bool(torch.any(covered)) else 0.0
