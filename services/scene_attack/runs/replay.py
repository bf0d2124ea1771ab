"""Reads the directory of a finished job, and renders both its images again, to check the result on this machine."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import torch
from pydantic import BaseModel, ValidationError
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from scene_attack.analysis.images import answer, load_png, of_images
from scene_attack.analysis.records import AnalysisRequest, Answer
from scene_attack.errors import InvalidRequest
from scene_attack.options import DEFAULTS, Options
from scene_attack.rendering.protocol import Parameters
from scene_attack.runs.exported_targets import register_exported
from scene_attack.runs.field_errors import in_words
from scene_attack.runs.prepare import prepare_exactly
from scene_attack.runs.result import ATTACKED, ORIGINAL, PERTURBATION, RESULT, Provenance, Result
from scene_attack.runs.spec import parse
from scene_attack.scenes.exported_assets import ASSETS, exported_library
from scene_attack.scenes.library import Library
from scene_attack.targets import registry


@dataclass(frozen=True)
class Stored:
    """A result, its perturbation and its images, uint8 [H, W, 3]."""

    result: Result
    perturbation: Parameters
    original: Tensor
    attacked: Tensor

    def check(self, initial: Parameters, groups: Sequence[str]) -> None:
        """Raises InvalidRequest("directory") unless the perturbation has these groups, with the shapes of `initial`."""
        expected = {group: list(initial[group].shape) for group in groups}
        shapes = {group: list(value.shape) for group, value in self.perturbation.items()}
        if shapes != expected:
            detail = f"its perturbation has the groups and shapes {shapes}, which are not {expected} of its request"
            raise InvalidRequest("directory", detail)
        if not all(value.isfinite().all() for value in self.perturbation.values()):
            raise InvalidRequest("directory", "its perturbation has values that are not finite")


def read_stored(directory: Path) -> Stored:
    """Reads the directory that `run --out` wrote, or into which `jobs download` put a job's files.

    Raises InvalidRequest("directory") if a file is missing or damaged.
    """
    try:
        return Stored(
            Result.model_validate_json((directory / RESULT).read_bytes()),
            load_file(directory / PERTURBATION),
            load_png(directory / ORIGINAL),
            load_png(directory / ATTACKED),
        )
    except ValidationError as error:
        first, *others = error.errors(include_url=False, include_input=False)
        detail = f"{'.'.join(map(str, first['loc'])) or 'the file'}: {in_words(first)}"
        more = f" (and {len(others)} more)" if others else ""
        raise InvalidRequest("directory", f"{directory / RESULT} is no result: {detail}{more}") from error
    except (OSError, ValueError, SafetensorError) as error:
        missing = [name for name in (RESULT, PERTURBATION, ORIGINAL, ATTACKED) if not (directory / name).is_file()]
        detail = f"there is no file {missing[0]}" if missing else str(error)  # safetensors does not say which
        raise InvalidRequest("directory", f"{directory} is not the output of a finished job: {detail}") from error


class Replay(BaseModel):
    """The stored answer to the attacked image, the answer to the one that was rendered again, and what differs."""

    stored: Answer
    replayed: Answer
    pixels_differing: int
    """Pixels in which the attacked image rendered again differs from the stored one, both 8 bits."""
    differs: tuple[str, ...]
    """The images and the fields of the result that are not what they are rendered again: both images, the answers to
    them, p of the saved images, and whether the attacked one meets the goal."""
    fooled: bool
    """Whether the replayed answer meets the goal."""
    same_backend: bool
    """Whether renderer and network are those of the stored result, so that all bits should agree."""
    reproduced: bool
    """Whether both labels agree, and on the same backend nothing differs."""


def replay(directory: Path, library: Library, limits: Options = DEFAULTS) -> Replay:
    """Renders the original and the attacked image of a result directory by the exact path, and asks the network.

    The directory is what `run --out` wrote, or an export, whose meshes and map take the place of `library`'s. Raises
    InvalidRequest("directory") if a file is missing or damaged, or if the network is missing or has other weights, and
    as `prepare_exactly` does. `limits` are those of reading an export's uploads.
    """
    kept = read_stored(directory)
    result, perturbation = kept.result, kept.perturbation
    register_exported(directory)
    spec = parse(result.spec).model_copy(update={"analysis": AnalysisRequest()})
    _check_weights(spec.target.name, result.provenance)
    with _assets(directory, library, limits) as assets:
        prepared = prepare_exactly(spec, assets)
    kept.check(prepared.renderer.initial(), spec.attack.groups)
    image = prepared.verifier.image(perturbation)
    if {kept.original.shape, kept.attacked.shape} != {image.shape}:
        raise InvalidRequest("directory", "its image has another size than the camera of its request")
    logits, labels, goal = prepared.verifier.logits(image), prepared.target.labels, prepared.settled.goal
    original, attacked = (answer(scores, labels, goal) for scores in (prepared.original.logits, logits))
    fooled = bool(goal.fooled(logits)) and prepared.verifier.holds(perturbation, goal)
    agrees = {
        ORIGINAL: torch.equal(prepared.original.saved, kept.original),
        ATTACKED: torch.equal(image, kept.attacked),
        "original": original == result.original,
        "attacked": attacked == result.attacked,
        "change.perceptibility": of_images(prepared.original.saved, image) == result.change.perceptibility,
        "verdict.verified": fooled == result.verdict.verified,
    }
    differs = tuple(name for name, same in agrees.items() if not same)
    same_labels = (original.label, attacked.label) == (result.original.label, result.attacked.label)
    same_backend = result.provenance.backend == prepared.backend
    return Replay(
        stored=result.attacked,
        replayed=attacked,
        pixels_differing=int((image != kept.attacked).any(dim=-1).sum()),
        differs=differs,
        fooled=fooled,
        same_backend=same_backend,
        reproduced=same_labels and not (same_backend and differs),
    )


@contextmanager
def _assets(directory: Path, library: Library, limits: Options) -> Iterator[Library]:
    if not (directory / ASSETS).is_dir():
        yield library
        return
    with exported_library(directory, limits) as assets:
        yield assets


def _check_weights(name: str, provenance: Provenance) -> None:
    """Raises InvalidRequest("directory") if the network of that name is another one, and as `registry.load` does."""
    weights = registry.load(name).weights_sha256
    if weights != provenance.weights_sha256:
        raise InvalidRequest(
            "directory",
            f"the weights of the network {name!r} on this machine have the SHA-256 {weights}; the "
            f"result is of those with {provenance.weights_sha256}",
        )
