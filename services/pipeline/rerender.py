"""The re-rendering defence of one image of a known scene."""

import torch
from torch import Tensor

from services.analysis.attribution import Tick
from services.analysis.records import Rerendering
from services.analysis.requests import RerenderingRequest
from services.errors import InvalidRequest
from services.pipeline.analyse import fitting_verifier, rerendered
from services.pipeline.prepare import resolved_scene
from services.pipeline.questions import asked_questions
from services.pipeline.spec import JobSpec
from services.scenes.image_file import other_size
from services.scenes.isolated_reading import reader
from services.scenes.library import Library
from services.targets import registry


def rerender_image(
    image: Tensor, spec: JobSpec, request: RerenderingRequest, library: Library, tick: Tick
) -> tuple[Rerendering, Tensor]:
    """Fits the scene of a spec to an image, uint8 [H, W, 3], and asks the spec's target about image and rendering.

    Returns the record and the rendering, uint8 [H, W, 3]. Raises InvalidRequest("image") for an image that is not of
    the camera's size, and as `resolve` and the target's registry do.
    """
    _check_size((image.shape[0], image.shape[1]), spec.scene.camera.size)
    asked_questions(spec, registry.load(spec.target.name))
    return rerendered(fitting_verifier(resolved_scene(spec, library), spec), image, request, tick)


def decode_image(data: bytes, size: tuple[int, int]) -> Tensor:
    """Reads a PNG, JPEG or WebP file as uint8 [H, W, 3], whose height and width must be `size`, in another process.

    Raises InvalidRequest("image"). The size is checked before the pixels are read.
    """
    return torch.from_numpy(reader().read_image(data, size).copy())


def _check_size(found: tuple[int, int], size: tuple[int, int]) -> None:
    if found != tuple(size):
        raise InvalidRequest("image", other_size(found, size))
