"""What an attack had found that was ended before its time: the best of its checkpoint, rendered exactly."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from services.analysis.images import answer, of_float_images, of_images
from services.analysis.physical import changes_in_words
from services.analysis.records import Answer
from services.attacks import run
from services.pipeline.prepare import prepare_exactly
from services.pipeline.result import BEST_SO_FAR
from services.pipeline.spec import JobSpec
from services.pipeline.stored import save_change
from services.rendering.color import to_bytes
from services.rendering.physical_change import Change
from services.scenes.library import Library


class BestSoFar(BaseModel):
    """The best perturbation of an attack that did not run to its end. It is no result.

    verified: the network's answer to the perturbation, rendered by the exact path and rounded to 8 bits, meets the
    goal.
    """

    model_config = ConfigDict(extra="forbid")

    step: int = Field(description="the step at which the perturbation was found")
    steps: int = Field(description="the steps until the checkpoint that it is of")
    queries: int = Field(description="images that the target classified until then")
    verified: bool
    original: Answer
    attacked: Answer
    float_perceptibility: float
    perceptibility: float
    changes: list[Change]


def best_so_far(spec: JobSpec, path: Path, out: Path, library: Library) -> BestSoFar | None:
    """Renders the best perturbation of the checkpoint `path` and asks the network; returns None without a checkpoint.

    Writes best-so-far.json and what was changed into `out`. Raises what `prepare_exactly` does.
    """
    found = run.best(path)
    if found is None:
        return None
    prepared = prepare_exactly(spec, library)
    verifier, goal, labels = prepared.verifier, prepared.goal, prepared.target.labels
    stored = {group: found.stored[group] for group in prepared.spec.attack.groups}
    exact = verifier.render(stored)
    attacked = to_bytes(exact).cpu()
    logits = verifier.logits(attacked)
    best = BestSoFar(
        step=found.stored_step,
        steps=found.step,
        queries=found.queries,
        verified=bool(goal.fooled(logits)),
        original=answer(prepared.logits, labels, goal),
        attacked=answer(logits, labels, goal),
        float_perceptibility=of_float_images(prepared.exact, exact),
        perceptibility=of_images(prepared.original, attacked),
        changes=changes_in_words(prepared.scene, prepared.renderer, stored),
    )
    save_change(prepared, stored, attacked, out)
    (out / BEST_SO_FAR).write_text(best.model_dump_json(indent=1) + "\n", "utf-8")
    return best
