"""Reads the output directory of a finished job."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from services.analysis.images import load_png
from services.errors import InvalidRequest
from services.pipeline.field_errors import in_words
from services.pipeline.perturbation_file import PERTURBATION
from services.pipeline.result import RESULT, Result
from services.rendering.protocol import Parameters

IMAGE = "attacked.png"


@dataclass(frozen=True)
class Stored:
    """A result, its perturbation and its attacked image, uint8 [H, W, 3]."""

    result: Result
    perturbation: Parameters
    attacked: Tensor


def read_stored(directory: Path) -> Stored:
    """Reads the directory that `run --out` wrote, or into which `jobs download` put a job's files.

    Raises InvalidRequest("directory") if a file is missing or damaged.
    """
    try:
        return Stored(
            Result.model_validate_json((directory / RESULT).read_bytes()),
            load_file(directory / PERTURBATION),
            load_png(directory / IMAGE),
        )
    except ValidationError as error:
        first, *others = error.errors(include_url=False, include_input=False)
        said = f"{'.'.join(map(str, first['loc'])) or 'the file'}: {in_words(first)}"
        more = f" (and {len(others)} more)" if others else ""
        raise InvalidRequest("directory", f"{directory / RESULT} is no result: {said}{more}") from error
    except (OSError, ValueError, SafetensorError) as error:
        missing = [name for name in (RESULT, PERTURBATION, IMAGE) if not (directory / name).is_file()]
        said = f"there is no file {missing[0]}" if missing else str(error)  # safetensors does not say which
        raise InvalidRequest("directory", f"{directory} is not the output of a finished job: {said}") from error
