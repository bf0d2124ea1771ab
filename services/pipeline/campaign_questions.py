"""The scenes of a campaign's grid with questions: scenes after CLEVR from a seed, and generated questions about each.

This module does not import torch.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Self, get_args

from pydantic import Field, field_validator, model_validator

from services.attacks.spec import Seed
from services.errors import InvalidRequest
from services.pipeline.question_request import MOST_TOGETHER
from services.questions.generator import QuestionGenerator
from services.questions.records import QuestionRecord
from services.questions.templates.families import FAMILIES, Kind
from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import MAX_OBJECTS, MIN_OBJECTS, generate
from services.scenes.clevr.records import SceneRecord
from services.scenes.clevr.rig import IMAGE_SIZE
from services.scenes.description import Model, Pixels, Scene
from services.suggestions import there_are

MAX_IMAGES = 2000
"""Largest number of scenes of a grid with questions; each takes a few milliseconds to make."""
KINDS: tuple[str, ...] = get_args(Kind)

Count = Annotated[int, Field(ge=1, le=MAX_OBJECTS)]


@dataclass(frozen=True)
class Member:
    """A scene of a grid, and the questions that a job asks about it; a scene without questions has no record."""

    scene: Scene
    record: SceneRecord | None = None
    questions: tuple[QuestionRecord, ...] = ()


class QuestionGrid(Model):
    """Scenes after CLEVR, and questions about them. Each question is a case of its own, or those of a scene together.

    They follow from this request alone, on every machine.
    """

    images: Annotated[int, Field(ge=1, le=MAX_IMAGES)] = Field(description="number of scenes")
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(0, description="seed of the scenes")
    first: Annotated[int, Field(ge=0, le=2**62)] = Field(
        0, description="number of the first scene among those of the seed; the others follow it"
    )
    objects: tuple[Count, Count] = Field(
        (MIN_OBJECTS, MAX_OBJECTS), description="fewest and most objects of a scene, between which each is drawn"
    )
    questions: Annotated[int, Field(ge=1, le=MOST_TOGETHER)] = Field(
        1, description="number of questions about each scene, of different families"
    )
    question_seed: Seed = Field(0, description="seed of the questions")
    kinds: tuple[str, ...] = Field((), max_length=len(KINDS), description="kinds of question families; empty: all")
    together: bool = Field(
        False, description="attack the questions about a scene together, in one job; else each in one of its own"
    )
    size: tuple[Pixels, Pixels] = Field(IMAGE_SIZE, description="height and width of the images, pixels")
    shadows: bool = Field(True, description="draw shadows")

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

    def members(self) -> tuple[Member, ...]:
        """Returns all scenes with their questions, in order. Raises InvalidRequest for objects that do not fit."""
        return _members(self)

    def sample(self) -> Member:
        """Returns the first scene, with one question about it.

        Raises InvalidRequest as `members` does, and if no such question can be asked about this scene.
        """
        one = self.model_copy(update={"images": 1, "together": False})
        found = next(_made(one), None)
        if found is None:
            raise InvalidRequest("generate.kinds", "no such question can be asked about the first scene")
        return found


@lru_cache(maxsize=4)
def _members(grid: QuestionGrid) -> tuple[Member, ...]:
    return tuple(_made(grid))


def _made(grid: QuestionGrid) -> Iterator[Member]:
    families = [family for family in FAMILIES if not grid.kinds or family.kind in grid.kinds]
    asking = QuestionGenerator(grid.question_seed, families)
    for index in range(grid.first, grid.first + grid.images):
        try:
            record = generate(grid.seed, index, objects=grid.objects)
        except InvalidRequest as error:
            raise InvalidRequest(f"generate.{error.field}", error.detail) from error
        scene = describe(record, grid.size)
        if not grid.shadows:
            scene = scene.model_copy(update={"shadows": None})
        questions = tuple(asking.ask(record, grid.questions))
        if not grid.together:
            yield from (Member(scene, record, (question,)) for question in questions)
        elif len(questions) == grid.questions:  # a scene about which so many cannot be asked is left out
            yield Member(scene, record, questions)
