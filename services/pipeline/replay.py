"""Renders the perturbation of a stored result again, to check the result on this machine."""

from pathlib import Path

from pydantic import BaseModel

from services.analysis.answers import answer
from services.analysis.records import Answer
from services.pipeline.prepare import prepare
from services.pipeline.spec import parse
from services.pipeline.stored import read_stored
from services.scenes.library import Library


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


def replay(directory: Path, library: Library) -> Replay:
    """Renders the perturbation in a result directory by the exact path and asks the network.

    Raises InvalidRequest("directory") if a file is missing or damaged, and as `prepare` does.
    """
    kept = read_stored(directory)
    result, perturbation, stored = kept.result, kept.perturbation, kept.attacked
    prepared = prepare(parse(result.spec), library)
    image = prepared.verifier.image(perturbation)
    logits = prepared.verifier.logits(image)
    return Replay(
        stored=result.attacked,
        replayed=answer(logits, prepared.target.labels, prepared.goal),
        pixels_differing=int((image != stored).any(dim=-1).sum()),
        fooled=bool(prepared.goal.fooled(logits)),
        same_backend=result.provenance.backend == prepared.backend,
    )
