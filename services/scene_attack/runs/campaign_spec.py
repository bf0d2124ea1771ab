"""The request of a campaign: grids of scenes × targets × attacks × seeds, or a list of jobs.

It is the same JSON for `POST /v1/campaigns` and `scene-attack campaign run`. The scenes of a grid are listed, or are
meshes × views with one object each, or are made for the networks' task with what is asked about each. This module does
not import torch.
"""

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from math import pi
from random import Random
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from scene_attack.analysis.records import AnalysisRequest
from scene_attack.attacks.attack import Attack
from scene_attack.attacks.request import Seed
from scene_attack.errors import below
from scene_attack.rendering.plan import DEFAULT_TOLERANCE
from scene_attack.runs.spec import (
    AnyAttack,
    AnyTolerance,
    Goal,
    JobSpec,
    TargetChoice,
    check_labels,
    parsed,
    with_method,
)
from scene_attack.runs.task_parts import AnyCases, Member, models_of
from scene_attack.scenes import furniture
from scene_attack.scenes.description import Angle, Camera, Colour, Lights, MeshName, Scene, SceneObject
from scene_attack.scenes.source import SOURCES
from scene_attack.strict import Model, Names, Several, absent, reference
from scene_attack.text import line, there_are

MAX_LISTED = 20_000
"""Largest number of scenes, meshes or jobs that a campaign may list."""

Listed = TypeVar("Listed")


def once(value: tuple[Listed, ...]) -> tuple[Listed, ...]:
    """The list itself. Raises ValueError if an entry comes twice: its jobs would count as so many cases."""
    seen: dict[Listed, int] = {}
    for index, entry in enumerate(value):
        if seen.setdefault(entry, index) != index:
            raise ValueError(f"{index}: is the same as entry {seen[entry]}; the same job is one case, list it once")
    return value


class RandomViews(Model):
    """Azimuths drawn uniformly from [0, π), as the paper's, for each mesh its own."""

    random: Annotated[int, Field(ge=1, le=1000)] = Field(description="number of azimuths of each mesh")
    seed: Seed = Field(default=0, description="seed of the azimuths; those of a mesh do not depend on the other meshes")


class SceneGrid(Model):
    """One object per scene: meshes × azimuths. All scenes have the same camera, lights, ground and material."""

    meshes: tuple[MeshName, ...] = Field(default=(), max_length=MAX_LISTED, description="names of meshes")
    kinds: tuple[str, ...] = Field(
        default=(), max_length=100, description="kinds of library furniture, all meshes of which are added"
    )
    per_kind: Annotated[int, Field(ge=1, le=1000)] | None = Field(
        default=None, description="only the first so many meshes of each kind; null: all"
    )
    views: RandomViews | Annotated[tuple[Angle, ...], Field(min_length=1, max_length=1000)] = Field(
        default=(Camera().azimuth,), description="azimuths in radians, or how many to draw at random"
    )
    material: Annotated[str, reference("material")] = Field(
        default="matte", max_length=64, description="kind of surface, which says how it reflects light (torch)"
    )
    camera: Camera = Field(default=Camera(), description="the camera, whose azimuth the views replace")
    lights: Lights = Lights()
    ground: Colour = Scene.model_fields["ground"].default

    @field_validator("kinds")
    @classmethod
    def _known_kinds(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for kind in value:
            if kind not in furniture.kinds():
                raise ValueError(f"there is no kind {kind!r}; {there_are(kind, furniture.kinds())}")
        return value

    @field_validator("views")
    @classmethod
    def _each_once(cls, value: RandomViews | tuple[float, ...]) -> RandomViews | tuple[float, ...]:
        return value if isinstance(value, RandomViews) else once(value)

    @model_validator(mode="after")
    def _some_meshes(self) -> Self:
        if not self.meshes and not self.kinds:
            raise ValueError("meshes: name at least one mesh, or a kind in `kinds`")
        return self

    def mesh_names(self) -> tuple[str, ...]:
        """The names of all meshes, each once: those listed, then those of the kinds, taking turns between kinds."""
        of_kinds = [furniture.kinds()[kind][: self.per_kind] for kind in self.kinds]
        turns = (mesh for turn in zip_longest(*of_kinds) for mesh in turn if mesh is not None)
        return tuple(dict.fromkeys((*self.meshes, *turns)))

    def azimuths(self, mesh: str) -> tuple[float, ...]:
        """The azimuths of a mesh's views."""
        if not isinstance(self.views, RandomViews):
            return self.views
        draw = Random(f"{self.views.seed} {mesh}").random  # a text seeds the same generator on every machine
        return tuple(pi * draw() for _ in range(self.views.random))

    def count(self) -> int:
        """The number of scenes, without making them."""
        names = self.mesh_names()
        return len(names) * len(self.azimuths(names[0]))

    def scenes(self) -> tuple[Scene, ...]:
        """The first view of every mesh, then the second of every mesh, and so on: a part of them has all kinds."""
        columns = [[self._scene(mesh, azimuth) for azimuth in self.azimuths(mesh)] for mesh in self.mesh_names()]
        return tuple(scene for row in zip(*columns, strict=True) for scene in row)

    def _scene(self, mesh: str, azimuth: float) -> Scene:
        return Scene(
            camera=self.camera.model_copy(update={"azimuth": azimuth}),
            objects=(SceneObject(mesh=mesh, material=self.material),),
            lights=self.lights,
            ground=self.ground,
        )


MOST_GENERATED = 200
"""Jobs in a list whose scenes are to be generated, 10 ms each before the answer; a grid's are made afterwards."""


Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(line)]


def _confident(value: object) -> bool:
    """Whether it is the default from before there was a choice, which a stored request leaves out."""
    return value == "confident"


class Selection(Model):
    """The views that are attacked: those whose first answer is right, and of these the preferred ones."""

    right: bool = Field(default=True, description="only views whose truth is known and whose first answer is right")
    least_confidence: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = Field(
        default=0.0, description="least probability of the first answer"
    )
    per_mesh: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="the most confident so many views of each mesh; null: all"
    )
    per_class: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="the most confident so many views of each class (views of the same truth); null: all"
    )
    most: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="the most confident so many views of all that are left; null: all"
    )
    shared: bool = Field(
        default=False,
        description="attack the same views of every target of the grid, as in the paper: the rules hold for all of "
        "them, and the most confident are those of the grid's first target",
    )
    prefer: Literal["confident", "listed"] = Field(
        default="confident",
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


# What type checkers know of the fields of a grid: lists are taken, and dictionaries in place of models.
if TYPE_CHECKING:
    from scene_attack.strict import Converted

    Part = Mapping[str, Any]
    GivenScenes = Converted[SceneGrid | tuple[Scene, ...] | None, SceneGrid | Part | Sequence[Scene | Part] | None]
    GivenTargets = Converted[tuple[TargetChoice, ...], Sequence[TargetChoice | Part | str]]
    GivenColumns = Converted[tuple[Column, ...], Sequence[Column | Part]]
    GivenSelection = Converted[Selection, Selection | Part]
else:
    GivenScenes = SceneGrid | Annotated[tuple[Scene, ...], Field(min_length=1, max_length=MAX_LISTED)] | None
    GivenTargets, GivenColumns, GivenSelection = tuple[NamedTarget, ...], tuple[Column, ...], Selection


class Grid(Model):
    """All combinations of scenes, targets, attacks and seeds."""

    scenes: GivenScenes = Field(
        default=None,  # type: ignore[arg-type]
        exclude_if=absent,
        description="scenes, or meshes and views to make them of",
    )
    targets: GivenTargets = Field(
        default=(TargetChoice(),),  # type: ignore[arg-type]
        min_length=1,
        max_length=32,
        description="the networks; each is a row of the table; one that is asked nothing may be written as its name",
    )
    generate: AnyCases | None = Field(
        default=None,
        exclude_if=absent,
        description="in place of `scenes`: scenes for the task of the networks to make, and what is asked about each",
    )
    attacks: GivenColumns = Field(min_length=1, max_length=64)
    seeds: Several[Seed] = Field(default=(0,), min_length=1, max_length=1000)  # type: ignore[arg-type]
    goal: Goal = Field(default=Goal(), description="the goal of every job; the truth is each scene's own")
    tolerance: AnyTolerance = DEFAULT_TOLERANCE
    analysis: AnalysisRequest = Field(
        default=AnalysisRequest(), description="analyses to make after each attack; default none"
    )
    selection: GivenSelection = Field(default=Selection(), description="which views are attacked")  # type: ignore[arg-type]

    @field_validator("goal")
    @classmethod
    def _known_labels(cls, value: Goal, info: ValidationInfo) -> Goal:
        if info.context and "target" in info.context:
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
    def _scenes_or_cases(self) -> Self:
        if self.scenes is None and self.generate is None:
            raise ValueError("scenes: is required, or `generate` in its place")
        if self.scenes is not None and self.generate is not None:
            raise ValueError("generate: leave it out where `scenes` is given")
        for index, target in enumerate(() if self.generate is None else self.targets):
            if type(self.generate) not in models_of("cases", target.name):
                raise ValueError(f"targets.{index}.name: {target.name} is asked nothing that `generate` makes")
            if target.ask is not None:
                raise ValueError(f"targets.{index}.ask: leave it out; what `generate` makes is asked")
        return self

    def members(self) -> tuple[Member, ...]:
        """All scenes, in order, with what is asked about them."""
        if self.generate is not None:
            with below("generate"):
                return self.generate.members()
        scenes = self.scenes.scenes() if isinstance(self.scenes, SceneGrid) else self.scenes
        return tuple(map(Member, scenes or ()))

    def sample(self) -> Member:
        """The first scene, with one thing asked if things are asked."""
        if self.generate is None:
            return self.members()[0]
        with below("generate"):
            return self.generate.sample()

    def count(self) -> int:
        """The largest number of members that there may be, without making them."""
        if self.generate is not None:
            return self.generate.count()
        return self.scenes.count() if isinstance(self.scenes, SceneGrid) else len(self.scenes or ())


def _is_slow(job: Any) -> bool:
    """Whether the scene of a job, as data, takes milliseconds to make."""
    try:
        source = job["scene"]["source"]
        field = SOURCES[source["format"]].slow
        return field is not None and source.get(field) is not None
    except (TypeError, KeyError, AttributeError):
        return False


class CampaignSpec(Model):
    """Many attacks that belong together: grids, single jobs, or both."""

    name: Name = "campaign"
    grids: Several[Grid] = Field(default=(), max_length=32)  # type: ignore[arg-type]
    jobs: Several[JobSpec] = Field(default=(), max_length=MAX_LISTED, description="jobs that are run as they are")  # type: ignore[arg-type]
    reuse: bool = Field(
        default=True,
        description="take the result of an earlier job with the same request, backend, weights and versions",
    )

    @field_validator("jobs", mode="before")
    @classmethod
    def _few_are_slow(cls, data: Any) -> Any:
        listed = data if isinstance(data, list | tuple) else ()
        count = sum(map(_is_slow, listed))
        if count > MOST_GENERATED:
            raise ValueError(
                f"the scenes of {count:,} jobs are to be made, and {MOST_GENERATED} may be; use `generate` of a grid"
            )
        return data

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not self.grids and not self.jobs:
            raise ValueError("grids: a campaign needs a grid, or jobs")
        return self

    @model_validator(mode="after")
    def _one_attack_in_a_cell(self) -> Self:
        cells: dict[tuple[str, str], Attack] = {}
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
    """Parses JSON data into a spec, as `spec.parsed` does."""
    return parsed(CampaignSpec, data, names)
