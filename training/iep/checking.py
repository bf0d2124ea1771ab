"""Accuracy of a checkpoint on scenes outside its training: from the text of a question to its answer."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from services.attacks.outcome import wilson
from services.errors import InvalidRequest
from services.questions.executor import ANSWERS
from services.questions.program import Program
from services.rendering.color import from_bytes
from services.targets.iep.assembly import Question, assemble
from services.targets.iep.checkpoint import Checkpoint
from services.targets.iep.engine import Engine
from services.targets.iep.program_generator import to_prefix
from training.iep.data import DataFolder, Images, Said, Shard, examples_of
from training.iep.engine_training import execute
from training.iep.examples import Example
from training.iep.recipe import Split

OVERALL = "overall"


@dataclass(frozen=True)
class Share:
    """The share of right answers. interval: Wilson's, of 95 %."""

    right: int
    of: int

    @property
    def share(self) -> float:
        """In [0,1]."""
        return self.right / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Its ends."""
        return wilson(self.right, self.of)


@torch.no_grad()
def answers(engine: Engine, features: Tensor, examples: Sequence[Example], batch: int = 64) -> list[str]:
    """Returns the engine's answers, given the true programs; `features` as for `execute`."""
    engine.eval()
    words: list[str] = []
    for start in range(0, len(examples), batch):
        scores = execute(engine, features, examples[start : start + batch]).scores
        words += [ANSWERS[number] for number in scores.argmax(1).tolist()]
    return words


def by_family(examples: Sequence[Example], right: Sequence[bool]) -> dict[str, Share]:
    """Returns the shares of right answers overall and of each family, of one example at least."""
    families: dict[str, list[bool]] = {}
    for example, correct in zip(examples, right, strict=True):
        families.setdefault(example.family, []).append(correct)
    return {name: Share(sum(of), len(of)) for name, of in [(OVERALL, right), *sorted(families.items())]}


AT_ONCE = 20
"""Images that the network sees together, with all questions about them."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a question. group, renderer: those of its scene. right: the answer is right. program_right: the
    program is the true one, function by function."""

    example: Example
    group: str
    renderer: str
    right: bool
    program_right: bool


def outcomes(checkpoint: Checkpoint, data: DataFolder, split: Split, said: Said) -> list[Outcome]:
    """Returns the outcome of every question of a split."""
    rows: list[Outcome] = []
    pieces = data.pieces(split)
    for number, piece in enumerate(pieces):
        shard, part = data.read(piece), piece.part
        group = f"{part.objects[0]}-{part.objects[1]}"
        examples = list(examples_of([shard]))
        for example, (answer, program) in zip(examples, answered(checkpoint, shard, examples), strict=True):
            program_right = program is not None and to_prefix(program) == to_prefix(example.program)
            rows.append(Outcome(example, group, part.renderer, answer == example.answer, program_right))
        said("answering questions", number + 1, len(pieces), "")
    return rows


@torch.no_grad()
def answered(
    checkpoint: Checkpoint, shard: Shard, examples: Sequence[Example]
) -> list[tuple[str | None, Program | None]]:
    """Returns for each question about a shard's images the answer and the program; None where no program was made."""
    images = Images([shard])
    programs = checkpoint.generator.generate([example.text for example in examples])
    answers: dict[int, str] = {}
    for start in range(0, len(images), AT_ONCE):
        shown = range(start, min(start + AT_ONCE, len(images)))
        asked, questions = [], []
        for place, (example, program) in enumerate(zip(examples, programs, strict=True)):
            if example.image in shown and not isinstance(program, InvalidRequest):
                asked.append(place)
                questions.append(Question(program, example.image - start))
        if questions:
            seen = from_bytes(torch.from_numpy(images(shown)))
            scores = checkpoint.network(seen, assemble(questions)).scores
            answers |= {place: ANSWERS[best] for place, best in zip(asked, scores.argmax(1).tolist(), strict=True)}
    return [
        (answers.get(place), None if isinstance(program, InvalidRequest) else program)
        for place, program in enumerate(programs)
    ]


def figures(found: Sequence[Outcome]) -> dict[str, Any]:
    """Returns the shares of right answers by number of objects, each overall and by family; those by renderer; and the
    share of right programs."""
    groups = sorted({one.group for one in found}, key=lambda group: [int(end) for end in group.split("-")])
    return {
        "answers": {
            group: {
                name: _written(share)
                for name, share in by_family([one.example for one in own], [one.right for one in own]).items()
            }
            for group in groups
            if (own := [one for one in found if one.group == group])
        },
        "by_renderer": {
            name: _written(Share(sum(one.right for one in found if one.renderer == name), count))
            for name, count in sorted(Counter(one.renderer for one in found).items())
        },
        "programs": _written(Share(sum(one.program_right for one in found), len(found))),
    }


def disagreements(found: Mapping[str, Any], committed: Mapping[str, Any]) -> list[str]:
    """Returns a sentence for each share that is outside the committed 95 % interval, or that only one has."""
    ours, theirs = dict(_flat(found)), dict(_flat(committed))
    messages = [f"{name} is not in both" for name in sorted(set(ours) ^ set(theirs))]
    for name in sorted(set(ours) & set(theirs)):
        low, high = theirs[name]["wilson"]
        if not low <= ours[name]["share"] <= high:
            messages.append(f"{name} is {ours[name]['share']:.4f}, not within {low:.4f} and {high:.4f}")
    return messages


def _flat(value: Mapping[str, Any], name: str = "") -> list[tuple[str, Mapping[str, Any]]]:
    if "wilson" in value:
        return [(name, value)]
    return [pair for key, of in value.items() for pair in _flat(of, f"{name} {key}".strip())]


def _written(share: Share) -> dict[str, Any]:
    return {"right": share.right, "of": share.of, "share": share.share, "wilson": list(share.interval)}
