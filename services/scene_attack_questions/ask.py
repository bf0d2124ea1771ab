"""What a network that answers questions may be asked: one question, or several about the same image.

This module does not import torch.
"""

import operator
from collections.abc import Sequence
from typing import Annotated, Any, Self

from pydantic import AliasChoices, Field, field_validator, model_validator

from scene_attack.runs.task_parts import Ask, Member
from scene_attack.scenes.description import Scene
from scene_attack.strict import Model, absent
from scene_attack.targets.info import ANY_QUESTION, TargetInfo
from scene_attack_questions.program import FUNCTIONS, MAX_NODES, TYPE_WORDS, InvalidProgram, Program, written

MOST_TEXT = 1000
"""Characters of a question."""
MOST_TOGETHER = 16
"""Questions about one image that are attacked together."""
Word = Annotated[str, Field(max_length=40)]


class Call(Model):
    """A function of a question's program, as in CLEVR's question files; its generator's words for the fields count."""

    function: Word = Field(
        validation_alias=AliasChoices("function", "type"), description="a function of the language, e.g. `filter_color`"
    )
    inputs: tuple[int, ...] = Field(
        default=(), max_length=8, description="numbers of the earlier functions whose outputs it takes, from 0"
    )
    value_inputs: tuple[Word, ...] = Field(
        default=(),
        max_length=8,
        validation_alias=AliasChoices("value_inputs", "side_inputs"),
        description='its values, e.g. ["red"]',
    )


Calls = Annotated[tuple[Call, ...], Field(max_length=MAX_NODES)]
Text = Annotated[str, Field(max_length=MOST_TEXT)]


class Questions(Ask):
    """What a network that answers questions is asked about the image."""

    question: Text | Calls | None = Field(
        default=None, exclude_if=absent, description="the question: in words, or its program as in CLEVR's files"
    )
    questions: tuple[Text | Calls, ...] = Field(
        default=(),
        max_length=MOST_TOGETHER,
        exclude_if=operator.not_,
        description="in place of `question`, several about the same image, whose answers are attacked together",
    )
    leave_kind: bool = Field(
        default=False,
        exclude_if=operator.not_,
        description="the new answer must be of another kind than the question asks for, such as `yes` to a question "
        "about a shape",
    )

    @field_validator("question")
    @classmethod
    def _valid_program(cls, value: Any) -> Any:
        if isinstance(value, tuple):
            program(value)
        return value

    @field_validator("questions")
    @classmethod
    def _valid_programs(cls, value: tuple[Any, ...]) -> Any:
        for number, question in enumerate(value):
            if isinstance(question, tuple):
                try:
                    program(question)
                except ValueError as error:
                    node, colon, detail = str(error).partition(": ")
                    message = f"{number}.{node}: {detail}" if colon else f"{number}: {error}"
                    raise ValueError(message) from error
        return value

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        if self.questions and self.question is not None:
            raise ValueError("questions: give either `question` or `questions`")
        return self

    @property
    def asked(self) -> tuple[str | tuple[Call, ...], ...]:
        """All questions, in order."""
        return self.questions if self.question is None else (self.question,)

    @property
    def texts(self) -> tuple[str, ...]:
        """The questions as targets take them, each one text: its words, or its program as JSON."""
        return tuple(one if isinstance(one, str) else written(program(one)) for one in self.asked)

    @property
    def names(self) -> tuple[str, ...]:
        """The questions: their words, or "A program of 9 functions that asks for a number"."""
        return tuple(
            one if isinstance(one, str) else program_name([call.function for call in one]) for one in self.asked
        )

    @property
    def name(self) -> str:
        """The question, or "4 questions about one image"."""
        return self.names[0] if len(self.asked) == 1 else f"{len(self.asked)} questions about one image"

    @classmethod
    def example(cls, target: TargetInfo, scene: Scene) -> Member:
        """The question of the target's card, or any, about the scene; of CLEVR's vocabulary about a generated one."""
        ask = cls(question=target.example or ANY_QUESTION)
        if target.vocabulary != "clevr":
            return Member(scene, ask)
        return Member(Scene.model_validate({"source": {"format": "clevr", "generate": {}}}), ask)

    @property
    def goal(self) -> str | None:
        """The goal of leaving the kind of answers."""
        if not self.leave_kind:
            return None
        return "an answer of another kind than the question asks for. A wrong answer of its kind does not meet it."


def program(calls: tuple[Call, ...]) -> Program:
    """Returns the program of a request. Raises ValueError, which names the first invalid function by its number."""
    parsed = Program.read([call.model_dump() for call in calls])
    try:
        parsed.check()
    except InvalidProgram as error:
        raise ValueError(error.detail if error.node is None else f"{error.node}: {error.detail}") from error
    return parsed


def program_name(functions: Sequence[str]) -> str:
    """The name of a question that is given as a program of these functions."""
    count = "1 function" if len(functions) == 1 else f"{len(functions)} functions"
    return f"A program of {count} that asks for {TYPE_WORDS[FUNCTIONS[functions[-1]].output]}"
