"""Example images of the study: of each physical attack the verified success whose p is the median, so that nobody
chose it, of the campaign's first network that has one.

For each one three images are written (the scene before, attacked and rendered afresh, and the difference times 5), and
a line of examples.json, from which the page has labels and confidences.
"""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from benchmarks.study.record import Job, Record
from scene_attack.analysis.second_opinion import image_file
from scene_attack.runs.result import Result

IMAGES = {"original": "before", "attacked": "attacked", "perturbation": "difference"}
"""Names of a job's images, and of their files beside the page."""
PIXELS = "image"
"""Name of the column that attacks pixels, which has no example: its differences are noise."""


class Answered(BaseModel):
    """A question of an example, with the network's answers before and after."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    question: str
    before: str
    before_confidence: float
    after: str
    after_confidence: float


class Opinion(BaseModel):
    """What the network answers when another renderer draws an example; its image is `<name>-<renderer>.png`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    renderer: str
    after: str
    after_confidence: float
    outcome: str


class Example(BaseModel):
    """An adversary that the page shows. Its images are `<name>-before.png`, `-attacked.png` and `-difference.png`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    campaign: str
    target: str
    attack: str
    mesh: str
    before: str
    before_confidence: float
    after: str
    after_confidence: float
    p: float
    request: str
    credits: tuple[str, ...]
    words: tuple[str, ...] = ()
    """What was changed, in words and units."""
    questions: tuple[Answered, ...] = ()
    opinions: tuple[Opinion, ...] = ()

    @property
    def files(self) -> dict[str, str]:
        """The names of its images: by those of a job's, those beside the page."""
        drawn = {image_file(one.renderer, "attacked"): f"{self.name}-{one.renderer}.png" for one in self.opinions}
        return {f"{image}.png": f"{self.name}-{called}.png" for image, called in IMAGES.items()} | drawn


def median_success(jobs: Sequence[Job]) -> Job | None:
    """The success with the median p (of an even number the lower one); None if there is no success."""
    won = sorted((job for job in jobs if job.success), key=lambda job: (job.p or 0.0, job.request))
    return won[(len(won) - 1) // 2] if won else None


def of_record(record: Record, name: str, folder: Path, out: Path) -> list[Example]:
    """Copies the images of each example out of a campaign's folder, and returns the examples."""
    chosen: list[Example] = []
    table = record.table()
    for attack in table.attacks:
        by_target = ([job for job in record.jobs if (job.target, job.attack) == (t, attack)] for t in table.targets)
        job = next((candidate for candidate in map(median_success, by_target) if candidate is not None), None)
        if job is None or attack == PIXELS:
            continue
        [place] = (folder / "jobs").glob(f"{job.request}*[0-9a-f]")
        result = Result.model_validate_json((place / "result.json").read_bytes())
        # the attack's name is a text of the campaign, which need not be a file's name
        chosen.append(
            Example(
                name=f"{name}-{len(chosen) + 1}",
                campaign=name,
                target=job.target,
                attack=job.attack,
                mesh=job.mesh,
                before=job.before,
                before_confidence=job.before_confidence,
                after=str(job.after),
                after_confidence=job.after_confidence or 0.0,
                p=job.p or 0.0,
                request=job.request,
                credits=tuple(result.provenance.credits),
                words=tuple(f"{change.subject} {change.sentence}" for change in result.change.things),
                questions=tuple(
                    Answered(
                        question=question.text,
                        before=str(question.before),
                        before_confidence=question.before_confidence or 0.0,
                        after=str(question.after),
                        after_confidence=question.after_confidence or 0.0,
                    )
                    for question in job.questions
                ),
                opinions=tuple(
                    Opinion(
                        renderer=one.renderer,
                        after=str(one.after.label),
                        after_confidence=one.after.confidence or 0.0,
                        outcome=str(one.outcome),
                    )
                    for one in result.analyses.second_opinion or ()
                    if one.after is not None
                ),
            )
        )
        for image, called in chosen[-1].files.items():
            shutil.copyfile(place / image, out / called)
    return chosen


def load(folder: Path) -> list[Example]:
    """The examples of a folder; none if it has no examples.json."""
    path = folder / "examples.json"
    return [Example.model_validate(example) for example in json.loads(path.read_text("utf-8"))] if path.exists() else []


def save(folder: Path, campaign: str, examples: Sequence[Example]) -> None:
    """Writes examples.json with these examples in place of the campaign's earlier ones, whose images it deletes."""
    kept = [example for example in load(folder) if example.campaign != campaign]
    named = {called for example in examples for called in example.files.values()}
    for path in folder.glob(f"{campaign}-*.png"):
        if path.name not in named:
            path.unlink()
    ordered = sorted([*kept, *examples], key=lambda example: example.name)  # whichever campaign was recorded last
    whole = (example.model_dump(mode="json", exclude_defaults=True) for example in ordered)
    lines = [json.dumps(example, ensure_ascii=False) for example in whole]
    (folder / "examples.json").write_text("[\n" + ",\n".join(lines) + "\n]\n", "utf-8")
