"""Makes the questions of a job's record out of its result and of what its modules attended to."""

from collections.abc import Sequence
from pathlib import Path

from safetensors.torch import load_file

from benchmarks.study.fooled_first import fooled_first
from benchmarks.study.record import Asked
from services.pipeline.described import can_carry, described
from services.pipeline.perturbation_file import PERTURBATION
from services.pipeline.question_record import ATTENTION, QuestionResult
from services.pipeline.result import Result
from services.pipeline.spec import JobSpec
from services.questions.answers import kind_asked
from services.questions.program import Program
from services.questions.records import QuestionRecord
from services.questions.templates.families import FAMILIES
from services.scenes.clevr.description import record_after
from services.scenes.clevr.records import SceneRecord
from training.iep.examples import ObjectTruth

DIGITS = 5
"""Significant digits of confidences."""


def asked(questions: Sequence[QuestionRecord], result: Result | None, folder: Path) -> tuple[Asked, ...]:
    """Returns the records of a job's questions. `folder` has its files; `result` is None if it failed.

    Raises ValueError if the network had another program than that of a question.
    """
    found = []
    for number, question in enumerate(questions):
        program, family, right = question.program, question.question_family_index, question.answer
        if program is None or family is None or right is None:
            raise ValueError(f"{question.question!r} has no program, family or answer")
        about = Asked(
            text=question.question,
            family=FAMILIES[family].kind,
            kind=kind_asked(program),
            functions=tuple(node.function for node in program.nodes),
            right=right,
        )
        if result is not None:
            about = _answered(about, program, result.questions[number])
            if about.fooled:
                about = about.model_copy(update={"first": _first(number, program, result, folder)})
        found.append(about)
    return tuple(found)


def _answered(about: Asked, program: Program, came: QuestionResult) -> Asked:
    if came.program != program.written() or came.right != about.right:
        raise ValueError(f"{about.text!r}: the result is of another program or truth")
    return about.model_copy(
        update={
            "right_after": came.right_after,
            "before": came.before.label,
            "before_confidence": float(f"{came.before.confidence:.{DIGITS}g}"),
            "after": came.after.label,
            "after_confidence": float(f"{came.after.confidence:.{DIGITS}g}"),
            "of_kind": came.after_of_kind,
            "outcome": came.outcome,
        }
    )


def _first(number: int, program: Program, result: Result, folder: Path) -> int:
    spec = JobSpec.model_validate(result.spec)
    assert spec.record is not None
    masks = load_file(folder / ATTENTION)
    nodes = [int(node) for question, node, when in (key.split(".") for key in masks) if question == str(number)]
    before, after = ({node: masks[f"{number}.{node}.{when}"] for node in nodes} for when in ("before", "after"))
    return fooled_first(program, before, after, _cells(spec.record), _cells(_attacked(spec, folder)))


def _cells(record: SceneRecord) -> list[int]:
    return [ObjectTruth.of(one).cell for one in record.objects]


def _attacked(spec: JobSpec, folder: Path) -> SceneRecord:
    assert spec.record is not None
    moved = load_file(folder / PERTURBATION)
    if not can_carry(spec.attack.renderer, tuple(moved)):
        return spec.record
    scene, _, _ = described(spec.scene, spec.attack.renderer, moved)
    return record_after(spec.record, scene)
