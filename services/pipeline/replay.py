"""A stored result rendered again from its perturbation alone: does it still hold, on this machine, now?"""

from pathlib import Path

from pydantic import BaseModel
from safetensors.torch import load_file

from services.analysis.answers import answer
from services.analysis.images import load_png
from services.analysis.records import Answer
from services.errors import InvalidRequest
from services.pipeline.execute import PERTURBATION
from services.pipeline.prepare import prepare
from services.pipeline.result import Result
from services.pipeline.spec import parse
from services.scenes.library import Library


class Replay(BaseModel):
    """What came out, beside what was stored."""

    stored: Answer
    replayed: Answer
    pixels_differing: int
    fooled: bool
    same_backend: bool


def replay(directory: Path, library: Library) -> Replay:
    """Renders the perturbation of a result directory by the exact path and asks the network.

    Raises InvalidRequest where a file is missing or damaged.
    """
    try:
        result = Result.model_validate_json((directory / "result.json").read_bytes())
        perturbation = load_file(directory / PERTURBATION)
        stored = load_png(directory / "attacked.png")
    except (OSError, ValueError) as error:
        raise InvalidRequest("directory", f"{directory} is not the output of a finished job: {error}") from error
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
