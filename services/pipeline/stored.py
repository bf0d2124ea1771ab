"""The output directory of a job: writes what an attack changed, and reads the directory of a finished job.

The perturbation is a safetensors file that says what its numbers are.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from services.analysis import images
from services.errors import InvalidRequest
from services.pipeline.field_errors import in_words
from services.pipeline.prepare import Prepared
from services.pipeline.result import RESULT, Result
from services.rendering.declaration import RENDERERS
from services.rendering.physical_change import change_images
from services.rendering.protocol import Parameters, Renderer

PERTURBATION = "perturbation.safetensors"
IMAGE = "attacked.png"


def save_change(prepared: Prepared, stored: Parameters, attacked: Tensor, out: Path) -> None:
    """Writes the files into the directory `out`. attacked: the exact image of `stored`, uint8 [H, W, 3]."""
    images.save_png(prepared.original.saved, out / "original.png")
    images.save_png(attacked, out / IMAGE)
    images.save_png(images.magnified(prepared.original.saved, attacked), out / "perturbation.png")
    for name, image in change_images(prepared.renderer, stored).items():
        images.save_png(image, out / name)
    save_perturbation(stored, prepared.renderer, out / PERTURBATION)


def save_perturbation(perturbation: Parameters, renderer: Renderer, path: Path) -> None:
    """Writes one tensor for each group: its change from the scene's own values, `describe` as metadata."""
    tensors = {group: value.contiguous() for group, value in perturbation.items()}
    # One entry: the library writes several in an order of its own, and the same job gives the same bytes.
    save_file(tensors, path, metadata={"groups": describe(perturbation, renderer)})


def describe(perturbation: Parameters, renderer: Renderer) -> str:
    """JSON: for each group its unit, its axes and, where they have names, its coordinates in flat order."""
    declared = {group.name: group for group in RENDERERS[renderer.name].groups}
    description = {
        group: {
            "unit": declared[group].unit,
            "axes": list(declared[group].shape),
            "names": renderer.names(group),
            "values": "change from the scene's own values",
        }
        for group in sorted(perturbation)
    }
    return json.dumps(description, ensure_ascii=False)


@dataclass(frozen=True)
class Stored:
    """A result, its perturbation and its attacked image, uint8 [H, W, 3]."""

    result: Result
    perturbation: Parameters
    attacked: Tensor

    def check(self, initial: Parameters, groups: Sequence[str]) -> None:
        """Raises InvalidRequest("directory") unless the perturbation has these groups, with the shapes of `initial`."""
        expected = {group: list(initial[group].shape) for group in groups}
        shapes = {group: list(value.shape) for group, value in self.perturbation.items()}
        if shapes != expected:
            detail = f"its perturbation has the groups and shapes {shapes}, which are not {expected} of its request"
            raise InvalidRequest("directory", detail)


def read_stored(directory: Path) -> Stored:
    """Reads the directory that `run --out` wrote, or into which `jobs download` put a job's files.

    Raises InvalidRequest("directory") if a file is missing or damaged.
    """
    try:
        return Stored(
            Result.model_validate_json((directory / RESULT).read_bytes()),
            load_file(directory / PERTURBATION),
            images.load_png(directory / IMAGE),
        )
    except ValidationError as error:
        first, *others = error.errors(include_url=False, include_input=False)
        detail = f"{'.'.join(map(str, first['loc'])) or 'the file'}: {in_words(first)}"
        more = f" (and {len(others)} more)" if others else ""
        raise InvalidRequest("directory", f"{directory / RESULT} is no result: {detail}{more}") from error
    except (OSError, ValueError, SafetensorError) as error:
        missing = [name for name in (RESULT, PERTURBATION, IMAGE) if not (directory / name).is_file()]
        detail = f"there is no file {missing[0]}" if missing else str(error)  # safetensors does not say which
        raise InvalidRequest("directory", f"{directory} is not the output of a finished job: {detail}") from error
