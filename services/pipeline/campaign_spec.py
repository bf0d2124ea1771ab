"""The model of a campaign: grids of scenes × targets × attacks × seeds, or a list of jobs.

It is the same JSON for `POST /v1/campaigns` and `scene-attack campaign run`. This module does not import torch.
"""

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from services.analysis.requests import AnalysisRequest
from services.attacks.spec import AttackSettings, Goal, Seed
from services.errors import InvalidFields, InvalidRequest
from services.names import Names
from services.pipeline.campaign_questions import Member, QuestionGrid
from services.pipeline.campaign_scenes import MAX_LISTED, SceneGrid, once
from services.pipeline.field_errors import invalid_fields
from services.pipeline.spec import AnyAttack, AnyTolerance, JobSpec, TargetChoice, check_labels, with_method
from services.rendering.plan import DEFAULT_TOLERANCE
from services.scenes.description import Model, Scene, absent
from services.written_text import line

MOST_GENERATED = 200
"""Jobs in a list whose scenes are to be generated, 10 ms each before the answer; a grid's are made afterwards."""


Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(line)]


def _confident(value: object) -> bool:
    """Whether it is what was done before there was a choice, so that a stored request leaves it out."""
    return value == "confident"


class Selection(Model):
    """The views that are attacked: those whose first answer is right, and of these the preferred ones."""

    right: bool = Field(True, description="only views whose truth is known and whose first answer is right")
    least_confidence: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = Field(
        0.0, description="least probability of the first answer"
    )
    per_mesh: Annotated[int, Field(ge=1)] | None = Field(
        None, description="the most confident so many views of each mesh; null: all"
    )
    per_class: Annotated[int, Field(ge=1)] | None = Field(
        None, description="the most confident so many views of each class (views of the same truth); null: all"
    )
    most: Annotated[int, Field(ge=1)] | None = Field(
        None, description="the most confident so many views of all that are left; null: all"
    )
    shared: bool = Field(
        False,
        description="attack the same views of every target of the grid, as in the paper: the rules hold for all of "
        "them, and the most confident are those of the grid's first target",
    )
    prefer: Literal["confident", "listed"] = Field(
        "confident",
        exclude_if=_confident,
        description="which views the rules that limit their number take: the most confident, as the paper takes views "
        "of objects, or those listed first; the paper draws its images with questions at random",
    )


class Column(Model):
    """An attack of a campaign, which is a column of its table."""

    name: Name = Field(description="name of the column")
    attack: AnyAttack

    @field_validator("attack", mode="before")
    @classmethod
    def _method(cls, data: Any) -> Any:
        return with_method(data)


def _by_name(target: Any) -> Any:
    return {"name": target} if isinstance(target, str) else target


NamedTarget = Annotated[TargetChoice, BeforeValidator(_by_name, json_schema_input_type=str | TargetChoice)]


class Grid(Model):
    """All combinations of scenes, targets, attacks and seeds."""

    scenes: SceneGrid | Annotated[tuple[Scene, ...], Field(min_length=1, max_length=MAX_LISTED)] | None = Field(
        None, exclude_if=absent, description="scenes, or meshes and views to make them of"
    )
    generate: QuestionGrid | None = Field(
        None, exclude_if=absent, description="in place of `scenes`: scenes after CLEVR, and questions about each"
    )
    targets: tuple[NamedTarget, ...] = Field(
        (TargetChoice(),),
        min_length=1,
        max_length=32,
        description="the networks; each is a row of the table; one that takes no question may be written as its name",
    )
    attacks: tuple[Column, ...] = Field(min_length=1, max_length=64)
    seeds: tuple[Seed, ...] = Field((0,), min_length=1, max_length=1000)
    goal: Goal = Field(Goal(), description="the goal of every job; the truth is each scene's own")
    tolerance: AnyTolerance = DEFAULT_TOLERANCE
    analysis: AnalysisRequest = Field(AnalysisRequest(), description="analyses to make after each attack; default none")
    selection: Selection = Field(Selection(), description="which views are attacked")

    @field_validator("goal")
    @classmethod
    def _known_labels(cls, value: Goal, info: ValidationInfo) -> Goal:
        if info.context:
            check_labels(value, info.data.get("targets", ()))
        return value

    @field_validator("attacks")
    @classmethod
    def _different_names(cls, value: tuple[Column, ...]) -> tuple[Column, ...]:
        names = [column.name for column in value]
        for index, name in enumerate(names):
            if name in names[:index]:
                raise ValueError(f"{index}.name: there is a column {name!r} already")
        return value

    @field_validator("scenes", "targets", "seeds")
    @classmethod
    def _each_once(cls, value: SceneGrid | tuple[Any, ...] | None) -> SceneGrid | tuple[Any, ...] | None:
        return once(value) if isinstance(value, tuple) else value

    @model_validator(mode="after")
    def _scenes_or_questions(self) -> Self:
        if self.scenes is None and self.generate is None:
            raise ValueError("scenes: is required, or `generate` in its place")
        if self.scenes is not None and self.generate is not None:
            raise ValueError("generate: leave it out where `scenes` is given")
        for index, target in enumerate(self.targets):
            if self.generate is not None and (target.question is not None or target.questions):
                raise ValueError(f"targets.{index}: leave its question out; those of `generate` are asked")
        return self

    def members(self) -> tuple[Member, ...]:
        """All scenes, in order, with the questions that are asked about them."""
        if self.generate is not None:
            return self.generate.members()
        scenes = self.scenes.scenes() if isinstance(self.scenes, SceneGrid) else self.scenes
        return tuple(map(Member, scenes or ()))

    def sample(self) -> Member:
        """The first scene, with one question if questions are asked."""
        return self.members()[0] if self.generate is None else self.generate.sample()

    def count(self) -> int:
        """The largest number of members that there may be, without making them."""
        if self.generate is not None:
            return self.generate.count()
        return self.scenes.count() if isinstance(self.scenes, SceneGrid) else len(self.scenes or ())


class CampaignSpec(Model):
    """Many attacks that belong together: grids, single jobs, or both."""

    name: Name = "campaign"
    grids: tuple[Grid, ...] = Field((), max_length=32)
    jobs: tuple[JobSpec, ...] = Field((), max_length=MAX_LISTED, description="jobs that are run as they are")
    reuse: bool = Field(
        True, description="take the result of an earlier job with the same request, backend, weights and versions"
    )

    @field_validator("jobs", mode="before")
    @classmethod
    def _few_generated(cls, data: Any) -> Any:
        listed = data if isinstance(data, list | tuple) else ()
        count = sum(isinstance(one, dict) and one.get("generate") is not None for one in listed)
        if count > MOST_GENERATED:
            raise ValueError(
                f"{count:,} jobs have `generate`, and {MOST_GENERATED} may; use `generate` of a grid for more"
            )
        return data

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not self.grids and not self.jobs:
            raise ValueError("grids: a campaign needs a grid, or jobs")
        return self

    @model_validator(mode="after")
    def _one_attack_in_a_cell(self) -> Self:
        cells: dict[tuple[str, str], AttackSettings] = {}
        for g, grid in enumerate(self.grids):
            for c, column in enumerate(grid.attacks):
                for target in grid.targets:
                    if cells.setdefault((target.name, column.name), column.attack) != column.attack:
                        raise ValueError(
                            f"grids.{g}.attacks.{c}.name: an earlier grid has a column {column.name!r} for "
                            f"{target.name} with another attack; give them two names, they would become one mean"
                        )
        return self


def parse(data: object, names: Names | None = None) -> CampaignSpec:
    """Parses JSON data into a spec. Raises InvalidFields, which has every bad field; `names` as in `spec.parse`."""
    try:
        return CampaignSpec.model_validate(data, context=names)
    except ValidationError as error:
        raise InvalidFields(named(error.errors(include_url=False))) from error


def named(items: Iterable[Mapping[str, Any]]) -> list[InvalidRequest]:
    """One InvalidRequest for each bad field, for the items of a pydantic error."""
    return invalid_fields(items, _schema())


@cache
def _schema() -> dict[str, Any]:
    return CampaignSpec.model_json_schema()
