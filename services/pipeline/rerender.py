"""The re-rendering defence of one image of a known scene."""

import torch
from torch import Tensor

from services.analysis.attribution import Tick
from services.analysis.records import Rerendering
from services.analysis.requests import RerenderingRequest
from services.errors import InvalidRequest
from services.pipeline.analyse import fitting_verifier, rerendered
from services.pipeline.prepare import resolved_scene
from services.pipeline.spec import JobSpec
from services.scenes.library import Library


def rerender_image(
    image: Tensor, spec: JobSpec, request: RerenderingRequest, library: Library, tick: Tick
) -> tuple[Rerendering, Tensor]:
    """Fits the scene of a spec to an image, uint8 [H, W, 3], and asks the spec's target about image and rendering.

    Returns the record and the rendering, uint8 [H, W, 3]. Raises InvalidRequest("image") for an image that is not of
    the camera's size, and as `resolve` and the target's registry do.
    """
    size = spec.scene.camera.size
    if tuple(image.shape) != (*size, 3) or image.dtype != torch.uint8:
        height, width = image.shape[:2]
        camera = f"{size[1]}×{size[0]} (scene.camera.size)"
        raise InvalidRequest("image", f"it has {width}×{height} pixels; the camera of the scene has {camera}")
    return rerendered(fitting_verifier(resolved_scene(spec, library), spec), image, request, tick)
