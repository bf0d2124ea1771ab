"""Makes the records of questions: programs, answers before and after, and what each function attended to."""

from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor

from services.analysis.answers import answer
from services.analysis.images import save_png
from services.attacks.verdict import SUCCESS, Verdict, judge
from services.pipeline.prepare import Prepared
from services.pipeline.question_record import ATTENTION, Attended, QuestionResult
from services.pipeline.questions import AskedQuestion
from services.questions.answers import ANSWERS, KINDS
from services.rendering.color import from_bytes
from services.rendering.protocol import Parameters
from services.targets.protocol import ProgramTarget

SCALE = 16
"""Pixels of an attention image for each side of a cell."""


@torch.no_grad()
def question_results(prepared: Prepared, stored: Parameters, attacked: Tensor, out: Path) -> list[QuestionResult]:
    """Returns a record of each question of a job, and writes the files of attention into `out`.

    stored: the perturbation. attacked: its exact image, uint8 [H, W, 3].
    """
    target = prepared.answering
    if target is None:
        return []
    texts = [question.asked for question in prepared.questions]
    # One image at a time, as in the verdict: no other image changes bits.
    ends = [from_bytes(image)[None] for image in (prepared.original, attacked)]
    scores = [target.answers(end, texts)[0] for end in ends]
    masks: dict[str, Tensor] = {}
    found = []
    for number, (question, goal) in enumerate(zip(prepared.questions, prepared.goals, strict=True)):
        before, after = (answer(of[number], ANSWERS, goal) for of in scores)
        right_after = question.right_after(prepared.renderer.name, stored)
        found.append(
            QuestionResult(
                **question.stated().model_dump(),
                right_after=right_after,
                before=before,
                after=after,
                before_of_kind=before.label in KINDS[question.kind],
                after_of_kind=after.label in KINDS[question.kind],
                outcome=judge(
                    (question.right,),
                    before.label,
                    after.label,
                    bool(goal.fooled(scores[1][number])),
                    () if right_after is None else (right_after,),
                ),
                attention=_attended(number, question, target, ends, masks, out),
            )
        )
    save_file(masks, out / ATTENTION)
    return found


def outcome_of(questions: Sequence[QuestionResult]) -> Verdict:
    """Returns the outcome of a job with questions: that of its only one; of several, which all were right before,
    "fooled" if each is.
    """
    if len(questions) == 1:
        return questions[0].outcome
    return SUCCESS if all(question.outcome == SUCCESS for question in questions) else "held"


def _attended(
    number: int,
    question: AskedQuestion,
    target: ProgramTarget,
    ends: Sequence[Tensor],
    masks: dict[str, Tensor],
    out: Path,
) -> list[Attended]:
    """Writes the images of a question's attention, and adds its masks to `masks`."""
    found = []
    both = [target.attention(end, question.asked) for end in ends]
    for node, (before, after) in enumerate(zip(*both, strict=True)):
        if before is None or after is None:
            continue
        names = [f"attention-{number}-{node:02}-{when}.png" for when in ("before", "after")]
        for name, when, mask in zip(names, ("before", "after"), (before[0], after[0]), strict=True):
            masks[f"{number}.{node}.{when}"] = mask.contiguous()
            save_png(_shown(mask), out / name)
        change = (after[0].double() - before[0].double()).abs()
        found.append(
            Attended(
                node=node,
                before=names[0],
                after=names[1],
                change=float(change.sum()),
                cell_change=float(change.max()),
            )
        )
    return found


def _shown(mask: Tensor) -> Tensor:
    """Returns a mask [h, w] as a grey image, uint8 [16 h, 16 w, 3]."""
    grey = (255 * mask.clamp(0, 1)).round().to(torch.uint8)
    large = grey.repeat_interleave(SCALE, dim=0).repeat_interleave(SCALE, dim=1)
    return large[..., None].expand(-1, -1, 3).contiguous()
