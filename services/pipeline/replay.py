"""Renders the perturbation of a stored result again, to check the result on this machine."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pydantic import BaseModel

from services.analysis.images import answer
from services.analysis.records import AnalysisRequest, Answer
from services.errors import InvalidRequest
from services.pipeline.exported_targets import register_exported
from services.pipeline.prepare import prepare_exactly
from services.pipeline.result import Provenance
from services.pipeline.spec import parse
from services.pipeline.stored import read_stored
from services.scenes.exported_assets import ASSETS, exported_library
from services.scenes.library import Library
from services.settings import DEFAULTS, Settings
from services.targets import registry


class Replay(BaseModel):
    """The stored answer and the answer to the image that was rendered again."""

    stored: Answer
    replayed: Answer
    pixels_differing: int
    """Pixels in which the image rendered again differs from the stored one, both 8 bits."""
    fooled: bool
    """Whether the replayed answer meets the goal."""
    same_backend: bool
    """Whether renderer and network are those of the stored result, so that all bits should agree."""


def replay(directory: Path, library: Library, limits: Settings = DEFAULTS) -> Replay:
    """Renders the perturbation in a result directory by the exact path and asks the network.

    The directory is what `run --out` wrote, or an export, whose meshes and map take the place of `library`'s. Raises
    InvalidRequest("directory") if a file is missing or damaged, or if the network is missing or has other weights, and
    as `prepare_exactly` does. `limits` are those of reading an export's uploads.
    """
    kept = read_stored(directory)
    result, perturbation, stored = kept.result, kept.perturbation, kept.attacked
    register_exported(directory)
    spec = parse(result.spec).model_copy(update={"analysis": AnalysisRequest()})
    _check_weights(spec.target.name, result.provenance)
    with _assets(directory, library, limits) as assets:
        prepared = prepare_exactly(spec, assets)
    kept.check(prepared.renderer.initial(), spec.attack.groups)
    image = prepared.verifier.image(perturbation)
    if image.shape != stored.shape:
        raise InvalidRequest("directory", "its image has another size than the camera of its request")
    logits = prepared.verifier.logits(image)
    return Replay(
        stored=result.attacked,
        replayed=answer(logits, prepared.target.labels, prepared.settled.goal),
        pixels_differing=int((image != stored).any(dim=-1).sum()),
        fooled=bool(prepared.settled.goal.fooled(logits)),
        same_backend=result.provenance.backend == prepared.backend,
    )


@contextmanager
def _assets(directory: Path, library: Library, limits: Settings) -> Iterator[Library]:
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
