"""The re-rendering defence of one image of a known scene."""

from torch import Tensor

from services.analysis.attribution import Tick
from services.analysis.images import pixels
from services.analysis.records import Rerendering
from services.analysis.requests import RerenderingRequest
from services.errors import InvalidRequest, out_of_memory
from services.pipeline.analyse import fitting_verifier, rerendered
from services.pipeline.prepare import resolved_scene
from services.pipeline.questions import asked_questions
from services.pipeline.spec import JobSpec
from services.scenes.image_file import FORMATS, open_image
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
    """Reads a PNG, JPEG or WebP file as uint8 [H, W, 3], whose height and width must be `size`.

    Raises InvalidRequest("image"). The size is checked before the pixels are read.
    """
    try:
        with open_image(data) as image:
            _check_size((image.height, image.width), size)
            return pixels(image)
    except InvalidRequest:
        raise
    except Exception as error:  # Pillow's parsers raise errors of many kinds for a damaged file
        if out_of_memory(error):
            raise
        raise InvalidRequest("image", f"it is not a {FORMATS} file, or it is damaged") from error


def _check_size(found: tuple[int, int], size: tuple[int, int]) -> None:
    if found != tuple(size):
        camera = f"{size[1]}×{size[0]} (scene.camera.size)"
        raise InvalidRequest("image", f"it has {found[1]}×{found[0]} pixels; the camera of the scene has {camera}")
