"""Scenes after CLEVR with generated questions, as a campaign's grid asks for them: `generate`.

This module does not import torch.
"""

import operator
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, Self, get_args

from pydantic import Field, field_validator, model_validator

from scene_attack.attacks.request import Seed
from scene_attack.errors import InvalidRequest
from scene_attack.runs.task_parts import Cases, Member
from scene_attack.scenes.description import Pixels, Scene
from scene_attack.text import there_are
from scene_attack_questions.ask import MOST_TOGETHER, Questions
from scene_attack_questions.clevr.description import describe
from scene_attack_questions.clevr.generator import MAX_OBJECTS, MIN_OBJECTS, generate
from scene_attack_questions.clevr.records import IMAGE_SIZE
from scene_attack_questions.families import FAMILIES, Kind
from scene_attack_questions.generator import QuestionGenerator, QuestionRecord
from scene_attack_questions.parts import QuestionsPlan
from scene_attack_questions.source import Clevr

MAX_IMAGES = 2000
"""Largest number of scenes of a grid with questions; each takes a few milliseconds to make."""
KINDS: tuple[str, ...] = get_args(Kind)

Count = Annotated[int, Field(ge=1, le=MAX_OBJECTS)]


@dataclass(frozen=True)
class QuestionMember(Member):
    """A scene of a grid, and the questions that a job asks about it."""

    questions: tuple[QuestionRecord, ...] = ()

    def refused(self, tasks: Mapping[str, Any]) -> str | None:
        """Why it is not attacked: the network would answer another question than the one that was generated."""
        stated = tasks.get("questions")
        due = [one.program.written() for one in self.questions if one.program is not None]
        if not isinstance(stated, QuestionsPlan) or [question.program for question in stated.questions] != due:
            return "the network has another program than that of the question"
        return None


class QuestionGrid(Cases):
    """Scenes after CLEVR, and questions about them. Each question is a case of its own, or those of a scene together.

    They follow from this request alone, on every machine.
    """

    images: Annotated[int, Field(ge=1, le=MAX_IMAGES)] = Field(description="number of scenes")
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(default=0, description="seed of the scenes")
    first: Annotated[int, Field(ge=0, le=2**62)] = Field(
        default=0, description="number of the first scene among those of the seed; the others follow it"
    )
    objects: tuple[Count, Count] = Field(
        default=(MIN_OBJECTS, MAX_OBJECTS),
        description="fewest and most objects of a scene, between which each is drawn",
    )
    questions: Annotated[int, Field(ge=1, le=MOST_TOGETHER)] = Field(
        default=1, description="number of questions about each scene, of different families"
    )
    question_seed: Seed = Field(default=0, description="seed of the questions")
    kinds: tuple[str, ...] = Field(
        default=(), max_length=len(KINDS), description="kinds of question families; empty: all"
    )
    together: bool = Field(
        default=False,
        description="attack the questions about a scene together, in one job; else each in one of its own",
    )
    size: tuple[Pixels, Pixels] = Field(default=IMAGE_SIZE, description="height and width of the images, pixels")
    shadows: bool = Field(default=True, description="draw shadows")
    leave_kind: bool = Field(
        default=False,
        exclude_if=operator.not_,
        description="the new answer must be of another kind than the question asks for",
    )

    @field_validator("objects")
    @classmethod
    def _in_order(cls, value: tuple[int, int]) -> tuple[int, int]:
        if value[0] > value[1]:
            raise ValueError(f"the fewest, {value[0]}, are more than the most, {value[1]}")
        return value

    @field_validator("kinds")
    @classmethod
    def _known_kinds(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for index, kind in enumerate(value):
            if kind not in KINDS:
                raise ValueError(f"{index}: there is no kind {kind!r}; {there_are(kind, KINDS)}")
        return value

    @model_validator(mode="after")
    def _several_together(self) -> Self:
        if self.together and self.questions == 1:
            raise ValueError("together: there is one question about each scene; leave it out, or ask several")
        return self

    def count(self) -> int:
        """Returns the largest number of members that there may be, without making them."""
        return self.images * (1 if self.together else self.questions)

    def members(self) -> tuple[QuestionMember, ...]:
        """Returns all scenes with their questions, in order. Raises InvalidRequest for objects that do not fit."""
        return _members(self)

    def sample(self) -> QuestionMember:
        """Returns the first scene, with one question about it.

        Raises InvalidRequest as `members` does, and if no such question can be asked about this scene.
        """
        single = self.model_copy(update={"images": 1, "together": False})
        member = next(_made(single), None)
        if member is None:
            raise InvalidRequest("kinds", "no such question can be asked about the first scene")
        return member


@lru_cache(maxsize=4)
def _members(grid: QuestionGrid) -> tuple[QuestionMember, ...]:
    return tuple(_made(grid))


def _made(grid: QuestionGrid) -> Iterator[QuestionMember]:
    families = [family for family in FAMILIES if not grid.kinds or family.kind in grid.kinds]
    asking = QuestionGenerator(grid.question_seed, families)
    for index in range(grid.first, grid.first + grid.images):
        record = generate(grid.seed, index, objects=grid.objects)
        scene = describe(record, grid.size).model_copy(update={"source": Clevr(format="clevr", record=record)})
        if not grid.shadows:
            scene = scene.model_copy(update={"shadows": None})
        questions = tuple(asking.ask(record, grid.questions))
        if not grid.together:
            yield from (_member(grid, scene, (question,)) for question in questions)
        elif len(questions) == grid.questions:  # a scene about which so many cannot be asked is left out
            yield _member(grid, scene, questions)


def _member(grid: QuestionGrid, scene: Scene, questions: tuple[QuestionRecord, ...]) -> QuestionMember:
    words = tuple(one.question for one in questions)
    asked: Any = {"question": words[0]} if len(words) == 1 else {"questions": words}
    return QuestionMember(scene, Questions(leave_kind=grid.leave_kind, **asked), questions)
