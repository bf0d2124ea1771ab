"""The questions of a job: their programs, their right answers by the scene's record, the goal, and their results.

One that answers by the program of its question is judged by the scene's record; of any other nothing but the scores is
known. Several questions about one image are attacked together, as a network of two answers (`Together`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import save_file
from torch import Tensor

from scene_attack.analysis.images import answer as answer_to
from scene_attack.analysis.images import save_png
from scene_attack.analysis.subsets import ScoredImage
from scene_attack.analysis.verdict import SUCCESS, Verdict, judge
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.errors import InvalidRequest
from scene_attack.rendering.color import from_bytes
from scene_attack.rendering.protocol import Parameters
from scene_attack.rendering.pyrender.declaration import has_groups_of_pyrender
from scene_attack.runs.classification import Classification, seen
from scene_attack.runs.described import can_carry, described
from scene_attack.runs.result import FirstAnswer
from scene_attack.runs.spec import AskedGoal, Goal, JobSpec, asked_goal
from scene_attack.runs.task import Settled, Task
from scene_attack.scenes.description import Scene
from scene_attack.targets import registry
from scene_attack.targets.protocol import QuestionTarget, Target
from scene_attack_questions.ask import Questions
from scene_attack_questions.clevr.description import record_after
from scene_attack_questions.clevr.records import SceneRecord
from scene_attack_questions.executor import ANSWERS, KINDS, Facts, IllPosed, answer, kind_asked
from scene_attack_questions.parts import QuestionsPlan, QuestionsResult
from scene_attack_questions.program import InvalidProgram, Program, Type, program_in
from scene_attack_questions.records import ATTENTION, Asked, Attended, QuestionResult
from scene_attack_questions.scene_limits import SceneLimits
from scene_attack_questions.source import Clevr
from scene_attack_questions.target import ProgramTarget
from scene_attack_questions.text import difference

FIELD = "target.ask.question"
KIND = "target.ask.leave_kind"
SCALE = 16
"""Pixels of an attention image for each side of a cell."""
TOGETHER_LABELS = ("an answer stays", "all answers have left")


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
        scene = described(self.scene, perturbation)
        try:
            return answer(self.program, Facts.of(record_after(self.record, scene)))
        except IllPosed:
            return None


def task_of(spec: JobSpec, network: Target, asked: AskedGoal) -> Task:
    """Returns the task of a request to a network that answers questions, given the goal in the network's labels.

    Raises InvalidRequest where there is no question, for several to a network that takes one, for a kind of answers to
    leave where it is not known, and as `check_analysis`, `asked_questions` and `QuestionTask` do.
    """
    ask = spec.target.ask
    if not isinstance(ask, Questions) or not ask.asked:
        raise InvalidRequest(FIELD, f"is required: {network.name} answers questions")
    if ask.questions:
        check_analysis(spec)
    if isinstance(network, ProgramTarget):
        return QuestionTask(network, asked_questions(spec, ask, network), spec, ask)
    if ask.questions:
        raise InvalidRequest(f"{FIELD}s", f"{network.name} takes one question")
    if ask.leave_kind:
        raise InvalidRequest(KIND, "only a question whose program is known has a kind of answers; leave it out")
    assert isinstance(network, QuestionTarget)
    return seen(spec, network.asked(ask.texts[0]), asked, ask.texts[0])


def check_analysis(spec: JobSpec) -> None:
    """Raises InvalidRequest for an analysis that asks one question, where there are several."""
    for name in ("transfer", "second_opinion", "survival", "interpretation", "rerendering", "adaptive"):
        if getattr(spec.analysis, name) is not None:
            raise InvalidRequest(f"analysis.{name}", "it asks one question, and there are several; leave it out")


class QuestionTask:
    """Questions about a scene after CLEVR, whose right answers follow from its record: a `Task`.

    One is attacked as a classification of answers, several are attacked together.
    """

    target: Target

    def __init__(
        self, network: ProgramTarget, questions: Sequence[AskedQuestion], spec: JobSpec, ask: Questions
    ) -> None:
        """Raises InvalidRequest as `goal_of` and `goals_together` do."""
        self._network, self._questions, self._goal = network, tuple(questions), spec.goal
        self._texts = [question.asked for question in questions]
        self._alone: Classification | None = None
        self._goals: tuple[ResolvedGoal, ...] = ()
        if ask.questions:
            self._goals = goals_together(spec.goal, questions, ask.leave_kind)
            self.target = Together(network, self._texts, self._goals)
        else:
            goal = asked_goal(
                goal_of(spec.goal, questions[0], ask.leave_kind), registry.card(network.name), network.labels
            )
            self.target = network.asked(self._texts[0])
            self._alone = Classification(self.target, goal, (), None)

    @torch.no_grad()
    def settle(self, original: Tensor, logits: Tensor) -> Settled:
        """As a classification is settled for one question.

        Raises InvalidRequest ("target.ask.questions.1") for one of several that the network gets wrong, as there is
        nothing to attack.
        """
        if self._alone is not None:
            return self._alone.settle(original, logits)
        for question, best in zip(self._questions, self._scores(original).argmax(dim=1).tolist(), strict=True):
            if ANSWERS[best] != question.right:
                raise InvalidRequest(
                    question.field,
                    f"the network gets it wrong before the attack: it says {ANSWERS[best]!r}, not {question.right!r}; "
                    "leave it out",
                )
        return Settled(self._goal, ResolvedGoal((0,), None), (0,), ())

    def constraint(self, renderer: str, initial: Parameters) -> SceneLimits | None:
        """That the questions find the same in the scene; None for a renderer that moves no object."""
        if not has_groups_of_pyrender(renderer):
            return None
        programs, first = [question.program for question in self._questions], self._questions[0]
        return SceneLimits(programs, first.record, first.scene, renderer, initial)

    def plan(self) -> QuestionsPlan:
        """The questions with their programs and right answers."""
        return QuestionsPlan(questions=tuple(question.stated() for question in self._questions))

    @torch.no_grad()
    def first_answers(self, original: Tensor, logits: Tensor, goal: ResolvedGoal) -> tuple[FirstAnswer, ...]:  # noqa: ARG002 - the protocol's
        """The answer to each question."""
        scores = self._scores(original)
        return tuple(
            FirstAnswer(asked=question.words or question.asked, answer=answer_to(scores[number], ANSWERS, own))
            for number, (question, own) in enumerate(zip(self._questions, self._goals or (goal,), strict=True))
        )

    @torch.no_grad()
    def judge(
        self, settled: Settled, renderer: str, stored: Parameters, before: ScoredImage, after: ScoredImage, out: Path
    ) -> tuple[Verdict, QuestionsResult]:
        """Each question by its right answers before and after; writes the files of attention into `out`."""
        # One image at a time, as in the verdict: no other image changes bits.
        ends = [from_bytes(image)[None] for image in (before.saved, after.saved)]
        scores = [self._network.answers(end, self._texts)[0] for end in ends]
        masks: dict[str, Tensor] = {}
        results = []
        for number, (question, goal) in enumerate(zip(self._questions, self._goals or (settled.goal,), strict=True)):
            first, last = (answer_to(of[number], ANSWERS, goal) for of in scores)
            right_after = question.right_after(renderer, stored)
            results.append(
                QuestionResult(
                    **question.stated().model_dump(),
                    right_after=right_after,
                    before=first,
                    after=last,
                    before_of_kind=first.label in KINDS[question.kind],
                    after_of_kind=last.label in KINDS[question.kind],
                    outcome=judge(
                        (question.right,),
                        first.label,
                        last.label,
                        bool(goal.fooled(scores[1][number])),
                        () if right_after is None else (right_after,),
                    ),
                    attention=_attended(number, question, self._network, ends, masks, out),
                )
            )
        save_file(masks, out / ATTENTION)
        return outcome_of(results), QuestionsResult(questions=results)

    def _scores(self, image: Tensor) -> Tensor:
        """The scores [Q, 28] of all questions to an image, uint8 [H, W, 3]."""
        return self._network.answers(from_bytes(image)[None], self._texts)[0]


def asked_questions(spec: JobSpec, ask: Questions, network: ProgramTarget) -> tuple[AskedQuestion, ...]:
    """Returns the questions of a job.

    Raises InvalidRequest for a question outside the language, an invalid program, and an ill-posed question
    ("target.ask.question"), and for a scene that has no record ("scene.source").
    """
    fields = [f"{FIELD}s.{number}" for number in range(len(ask.questions))] or [FIELD]
    entries = list(zip(fields, ask.asked, ask.texts, strict=True))
    programs = [_program(network, asked, field) for field, _, asked in entries]
    source = spec.scene.source
    if not isinstance(source, Clevr):
        example = '{"format": "clevr", "generate": {}}'
        raise InvalidRequest(
            "scene.source", f"is required: {network.name} is asked about scenes after CLEVR; make one by {example}"
        )
    record = source.stated()
    return tuple(
        AskedQuestion(
            field=field,
            words=question if isinstance(question, str) else None,
            asked=asked,
            program=program,
            kind=kind_asked(program),
            right=_right(program, record, field, question),
            record=record,
            scene=spec.scene,
        )
        for (field, question, asked), program in zip(entries, programs, strict=True)
    )


def goal_of(goal: Goal, question: AskedQuestion, leave_kind: bool) -> Goal:
    """Returns the goal of a request with the truth of its question, and the labels of the kind if these are to be left.

    Raises InvalidRequest for a truth that is not the question's, and for a label to leave beside a kind.
    """
    if goal.truth is not None and _names(goal.truth) != {question.right}:
        raise InvalidRequest(
            "goal.truth", f"the right answer is {question.right!r}, by the scene's record; leave it out"
        )
    goal = goal.model_copy(update={"truth": question.right})
    if not leave_kind:
        return goal
    if goal.leave is not None and _names(goal.leave) != set(KINDS[question.kind]):
        raise InvalidRequest("goal.leave", f"all answers of the kind {question.kind} are to be left; leave it out")
    return goal.model_copy(update={"leave": KINDS[question.kind]})


def _names(labels: object) -> set[object]:
    listed = labels if isinstance(labels, tuple) else (labels,)
    return {ANSWERS[label] if isinstance(label, int) and label < len(ANSWERS) else label for label in listed}


def _program(target: ProgramTarget, asked: str, field: str) -> Program:
    try:
        program = target.program(asked)
        other = None if program_in(asked) is not None else difference(asked, program)
        if other is not None:
            detail = f"the program made of it asks something else: {other}"
            raise InvalidRequest("question", f"{detail}; word it as CLEVR's questions are, or give its program")
    except InvalidProgram as error:
        raise InvalidRequest(field if error.node is None else f"{field}.{error.node}", error.detail) from error
    except InvalidRequest as error:
        raise InvalidRequest(field, error.detail) from error
    return program


def _right(program: Program, record: SceneRecord, field: str, question: object) -> str:
    try:
        return answer(program, Facts.of(record))
    except IllPosed as error:
        raise InvalidRequest(f"{field}.{error.node}" if isinstance(question, tuple) else field, error.detail) from error
    except InvalidRequest as error:
        raise InvalidRequest(field, error.detail) from error


class Together:
    """A target of two labels for questions with a goal each; implements `Target`.

    Its first label says that the answer to one of the questions still is as it was, its second that the goal of every
    question is met. The difference of their scores is the largest advantage of a question (`ResolvedGoal.advantage`),
    that of the question that is hardest at present. So every attack, the verifier and the trace work on it as on any
    network.
    """

    labels = TOGETHER_LABELS

    def __init__(self, target: ProgramTarget, asked: Sequence[str], goals: Sequence[ResolvedGoal]) -> None:
        self.name, self.input_size = target.name, target.input_size
        self.differentiable, self.weights_sha256 = target.differentiable, target.weights_sha256
        self._target, self._asked, self._goals = target, tuple(asked), tuple(goals)

    @property
    def backend(self) -> str:
        """That of the network."""
        return self._target.backend

    def logits(self, images: Tensor) -> Tensor:
        """Returns scores [B, 2] of images [B, H, W, 3] in [0,1]; see `Target.logits`."""
        scores = self._target.answers(images, self._asked)
        advantages = [goal.advantage(scores[:, number]) for number, goal in enumerate(self._goals)]
        hardest = torch.stack(advantages).amax(dim=0)
        return torch.stack([hardest / 2, -hardest / 2], dim=1)


def goals_together(goal: Goal, questions: Sequence[AskedQuestion], leave_kind: bool) -> tuple[ResolvedGoal, ...]:
    """Returns the goal of each question: to leave its right answer, or the kind of answers.

    Raises InvalidRequest for a goal that names labels, which would be those of one question.
    """
    for name in ("truth", "leave", "reach"):
        if getattr(goal, name) is not None:
            raise InvalidRequest(f"goal.{name}", "several questions have answers of their own; leave it out")
    return tuple(
        ResolvedGoal(
            tuple(ANSWERS.index(label) for label in (KINDS[question.kind] if leave_kind else (question.right,))),
            None,
            goal.least_confidence,
        )
        for question in questions
    )


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
    results = []
    both = [target.attention(end, question.asked) for end in ends]
    for node, (before, after) in enumerate(zip(*both, strict=True)):
        if before is None or after is None:
            continue
        names = [f"attention-{number}-{node:02}-{when}.png" for when in ("before", "after")]
        for name, when, mask in zip(names, ("before", "after"), (before[0], after[0]), strict=True):
            masks[f"{number}.{node}.{when}"] = mask.contiguous()
            save_png(_grey(mask), out / name)
        change = (after[0].double() - before[0].double()).abs()
        results.append(
            Attended(
                node=node,
                before=names[0],
                after=names[1],
                change=float(change.sum()),
                cell_change=float(change.max()),
            )
        )
    return results


def _grey(mask: Tensor) -> Tensor:
    """Returns a mask [h, w] as a grey image, uint8 [16 h, 16 w, 3]."""
    grey = (255 * mask.clamp(0, 1)).round().to(torch.uint8)
    large = grey.repeat_interleave(SCALE, dim=0).repeat_interleave(SCALE, dim=1)
    return large[..., None].expand(-1, -1, 3).contiguous()
