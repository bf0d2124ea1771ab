"""The question of a job: its program, its right answer by the scene's record, and the goal that follows from them."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isclose

from services.attacks.attack import Goal
from services.errors import InvalidRequest
from services.pipeline.described import can_carry, described
from services.pipeline.question_record import Asked
from services.pipeline.question_request import Call
from services.pipeline.spec import JobSpec, TargetChoice
from services.questions.answers import ANSWERS, KINDS, kind_asked
from services.questions.executor import IllPosed, answer
from services.questions.facts import Facts
from services.questions.functions import Type
from services.questions.program import InvalidProgram, Program
from services.questions.said import difference
from services.questions.written import program_in
from services.rendering.protocol import Parameters
from services.scenes.clevr.description import record_after, scene_of
from services.scenes.clevr.records import IMAGE_SIZE, SceneRecord
from services.scenes.description import Camera, Scene, SceneObject
from services.targets.protocol import ProgramTarget, QuestionTarget, Target

FIELD = "target.question"
PROPORTION = 0.01
"""Largest relative difference of an image's proportions from those of CLEVR's."""
ROUNDING = 1e-6
"""Largest difference between a scene and the one that follows from its record, for a record that was described on
another machine, whose trigonometric functions round differently."""


@dataclass(frozen=True)
class AskedQuestion:
    """A question about a scene after CLEVR.

    field: its path in the request. words: None if its program was given. asked: the text that the target is given.
    kind: of the answers that the program asks for. right: the right answer.
    """

    field: str
    words: str | None
    asked: str
    program: Program
    kind: Type
    right: str
    record: SceneRecord
    scene: Scene

    def stated(self) -> Asked:
        """Returns the question as plans and results state it."""
        return Asked(question=self.words, program=self.program.written(), kind=self.kind, right=self.right)

    def right_after(self, renderer: str, perturbation: Parameters) -> str | None:
        """Returns the right answer to the attacked scene; None if the question is ill-posed there."""
        if not can_carry(renderer, tuple(perturbation)):
            return self.right
        scene, _, _ = described(self.scene, renderer, perturbation)
        try:
            return answer(self.program, Facts.of(record_after(self.record, scene)))
        except IllPosed:
            return None


def bound(target: Target, choice: TargetChoice) -> Target:
    """Returns the target with the one question of a request; itself if it takes none."""
    return target if choice.asked is None or not isinstance(target, QuestionTarget) else target.asked(choice.asked)


def asked_questions(spec: JobSpec, target: Target) -> tuple[AskedQuestion, ...]:
    """Returns the questions of a job; none for a target without a program.

    Raises InvalidRequest for a question to a target that takes none and for none to one that does, for a question
    outside the language, an invalid program, and an ill-posed question ("target.question"); for a scene that has no
    record ("record"); and as `check_scene` does, whatever the target.
    """
    check_scene(spec)
    choice = spec.target
    given: list[tuple[str, str | tuple[Call, ...], str]] = []
    if choice.question is not None and choice.asked is not None:
        given.append((FIELD, choice.question, choice.asked))
    for number, (one, asked) in enumerate(zip(choice.questions, choice.together, strict=True)):
        given.append((f"{FIELD}s.{number}", one, asked))
    if not target.takes_question:
        if given:
            raise InvalidRequest(given[0][0], f"{target.name} answers no questions; leave it out")
        return ()
    if not given:
        raise InvalidRequest(FIELD, f"is required: {target.name} answers questions")
    if not isinstance(target, ProgramTarget):
        if choice.questions:
            raise InvalidRequest(f"{FIELD}s", f"{target.name} takes one question")
        return ()
    programs = [_program(target, asked, field) for field, _, asked in given]
    if spec.record is None:
        raise InvalidRequest(
            "record", f"{target.name} is asked about scenes after CLEVR; give the scene as `record` or `generate`"
        )
    return tuple(
        AskedQuestion(
            field=field,
            words=one if isinstance(one, str) else None,
            asked=asked,
            program=program,
            kind=kind_asked(program),
            right=_right(program, spec.record, field, one),
            record=spec.record,
            scene=spec.scene,
        )
        for (field, one, asked), program in zip(given, programs, strict=True)
    )


def goal_of(goal: Goal, questions: Sequence[AskedQuestion]) -> Goal:
    """Returns the goal of a request with the truth of its question, if it has one, and the labels of the kind if these
    are to be left.

    Raises InvalidRequest for a truth that is not the question's, for a kind to leave without a question, and for a
    label to leave beside a kind.
    """
    if not questions:
        if goal.leave_kind:
            raise InvalidRequest("goal.leave_kind", "only a question has a kind of answers; leave it out")
        return goal
    [question] = questions
    if goal.truth is not None and _names(goal.truth) != {question.right}:
        raise InvalidRequest(
            "goal.truth", f"the right answer is {question.right!r}, by the scene's record; leave it out"
        )
    goal = goal.model_copy(update={"truth": question.right})
    if not goal.leave_kind:
        return goal
    if goal.leave is not None and _names(goal.leave) != set(KINDS[question.kind]):
        raise InvalidRequest("goal.leave", f"all answers of the kind {question.kind} are to be left; leave it out")
    return goal.model_copy(update={"leave": KINDS[question.kind]})


def _names(labels: object) -> set[object]:
    listed = labels if isinstance(labels, tuple) else (labels,)
    return {ANSWERS[one] if isinstance(one, int) and one < len(ANSWERS) else one for one in listed}


def _program(target: ProgramTarget, asked: str, field: str) -> Program:
    try:
        program = target.program(asked)
        other = None if program_in(asked) is not None else difference(asked, program)
        if other is not None:
            said = f"the program made of it asks something else: {other}"
            raise InvalidRequest("question", f"{said}; word it as CLEVR's questions are, or give its program")
    except InvalidProgram as error:
        raise InvalidRequest(field if error.node is None else f"{field}.{error.node}", error.detail) from error
    except InvalidRequest as error:
        raise InvalidRequest(field, error.detail) from error
    return program


def _right(program: Program, record: SceneRecord, field: str, given: object) -> str:
    try:
        return answer(program, Facts.of(record))
    except IllPosed as error:
        raise InvalidRequest(f"{field}.{error.node}" if isinstance(given, tuple) else field, error.detail) from error
    except InvalidRequest as error:
        raise InvalidRequest(field, error.detail) from error


def check_scene(spec: JobSpec) -> None:
    """Checks a scene that is given beside its record.

    Raises InvalidRequest("scene") unless objects and camera are those of the record, and as `scene_of` does.
    Raises InvalidRequest("scene.camera.size") for an image of other proportions, whose frame would be another.
    """
    if spec.record is None:
        return
    scene, record = spec.scene, spec.record
    due = scene_of(record)
    same = len(scene.objects) == len(due.objects) and all(
        _is_same(one, other) for one, other in zip(scene.objects, due.objects, strict=True)
    )
    if not same or not _is_seen_from(scene.camera, due.camera):
        raise InvalidRequest("scene", "its objects and camera are not those of `record`; leave it out")
    rows, columns = scene.camera.size
    if not isclose(rows / columns, IMAGE_SIZE[0] / IMAGE_SIZE[1], rel_tol=PROPORTION):
        raise InvalidRequest(
            "scene.camera.size", f"{rows}×{columns} has not the proportions of CLEVR's images, 3 to 4, as 240×320 has"
        )
    if Facts.of(record_after(record, scene)) != Facts.of(record):
        raise InvalidRequest("record", "its attributes and relations are not those of its objects")


def _is_same(one: SceneObject, other: SceneObject) -> bool:
    fields = ("mesh", "material", "metallic", "roughness")
    vectors = ("color", "translation", "rotation")
    return (
        all(getattr(one, name) == getattr(other, name) for name in fields)
        and isclose(one.scale, other.scale, abs_tol=ROUNDING)
        and all(
            isclose(a, b, abs_tol=ROUNDING)
            for name in vectors
            for a, b in zip(getattr(one, name), getattr(other, name), strict=True)
        )
    )


def _is_seen_from(one: Camera, other: Camera) -> bool:
    places = ("azimuth", "elevation", "distance", "field_of_view")
    return all(isclose(getattr(one, name), getattr(other, name), abs_tol=ROUNDING) for name in places)
