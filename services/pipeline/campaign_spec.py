"""The model of a campaign: grids of scenes × targets × attacks × seeds, or a list of jobs.

It is the same JSON for `POST /v1/campaigns` and `scene-attack campaign run`. This module does not import torch.
"""

from collections.abc import Iterable, Mapping
from functools import cache
from itertools import zip_longest
from math import pi
from random import Random
from typing import Annotated, Any, Self, TypeVar

from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator

from services.analysis.requests import AnalysisRequest
from services.attacks.spec import AttackSettings, Goal, Seed
from services.errors import InvalidRequest, printable
from services.pipeline.field_errors import invalid_fields
from services.pipeline.spec import AnyAttack, AnyTolerance, JobSpec, TargetChoice, with_method
from services.rendering.plan import DEFAULT_TOLERANCE
from services.scenes import furniture_kinds
from services.scenes.description import Angle, Camera, Colour, Lights, Model, Scene, SceneObject
from services.suggestions import there_are

MAX_LISTED = 20_000
"""Largest number of scenes, meshes or jobs that a campaign may list."""


def _shown(name: str) -> str:
    """The name itself. Raises ValueError for control characters: terminals, which show names, would obey them."""
    if printable(name) != name:
        raise ValueError("it has characters that cannot be shown; use text of one line without control characters")
    return name


Name = Annotated[str, Field(min_length=1, max_length=100), AfterValidator(_shown)]


Listed = TypeVar("Listed")


def _once(value: tuple[Listed, ...]) -> tuple[Listed, ...]:
    """The list itself. Raises ValueError if an entry comes twice: its jobs would count as so many cases."""
    seen: dict[Listed, int] = {}
    for index, one in enumerate(value):
        if seen.setdefault(one, index) != index:
            raise ValueError(f"{index}: is the same as entry {seen[one]}; the same job is one case, list it once")
    return value


class RandomViews(Model):
    """Azimuths drawn uniformly from [0, π), as the paper's, for each mesh its own."""

    random: Annotated[int, Field(ge=1, le=1000)] = Field(description="number of azimuths of each mesh")
    seed: Seed = Field(0, description="seed of the azimuths; those of a mesh do not depend on the other meshes")


class SceneGrid(Model):
    """One object per scene: meshes × azimuths. All scenes have the same camera, lights, ground and material."""

    meshes: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = Field(
        (), max_length=MAX_LISTED, description="names of meshes"
    )
    kinds: tuple[str, ...] = Field(
        (), max_length=100, description="kinds of library furniture, all meshes of which are added"
    )
    per_kind: Annotated[int, Field(ge=1, le=1000)] | None = Field(
        None, description="only the first so many meshes of each kind; null: all"
    )
    views: RandomViews | Annotated[tuple[Angle, ...], Field(min_length=1, max_length=1000)] = Field(
        (Camera().azimuth,), description="azimuths in radians, or how many to draw at random"
    )
    material: str = Field("matte", max_length=64, description="DSBRDF preset of the torch renderer")
    camera: Camera = Field(Camera(), description="the camera, whose azimuth the views replace")
    lights: Lights = Lights()
    ground: Colour = Scene.model_fields["ground"].default

    @field_validator("kinds")
    @classmethod
    def _known_kinds(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for kind in value:
            if kind not in furniture_kinds.kinds():
                raise ValueError(f"there is no kind {kind!r}; {there_are(kind, furniture_kinds.kinds())}")
        return value

    @field_validator("views")
    @classmethod
    def _each_once(cls, value: RandomViews | tuple[float, ...]) -> RandomViews | tuple[float, ...]:
        return value if isinstance(value, RandomViews) else _once(value)

    @model_validator(mode="after")
    def _some_meshes(self) -> Self:
        if not self.meshes and not self.kinds:
            raise ValueError("meshes: name at least one mesh, or a kind in `kinds`")
        return self

    def mesh_names(self) -> tuple[str, ...]:
        """The names of all meshes, each once: those listed, then those of the kinds, taking turns between kinds."""
        of_kinds = [furniture_kinds.kinds()[kind][: self.per_kind] for kind in self.kinds]
        turns = (mesh for turn in zip_longest(*of_kinds) for mesh in turn if mesh is not None)
        return tuple(dict.fromkeys((*self.meshes, *turns)))

    def azimuths(self, mesh: str) -> tuple[float, ...]:
        """The azimuths of a mesh's views."""
        if not isinstance(self.views, RandomViews):
            return self.views
        draw = Random(f"{self.views.seed} {mesh}").random  # a text seeds the same generator on every machine
        return tuple(pi * draw() for _ in range(self.views.random))

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


class Selection(Model):
    """The views that are attacked: those whose first answer is right, the most confident first, as in the paper."""

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


class Column(Model):
    """An attack of a campaign, which is a column of its table."""

    name: Name = Field(description="name of the column")
    attack: AnyAttack

    @field_validator("attack", mode="before")
    @classmethod
    def _method(cls, data: Any) -> Any:
        return with_method(data)


class Grid(Model):
    """All combinations of scenes, targets, attacks and seeds."""

    scenes: SceneGrid | Annotated[tuple[Scene, ...], Field(min_length=1, max_length=MAX_LISTED)] = Field(
        description="scenes, or meshes and views to make them of"
    )
    targets: tuple[TargetChoice, ...] = Field(
        (TargetChoice(),), min_length=1, max_length=32, description="the networks; each is a row of the table"
    )
    attacks: tuple[Column, ...] = Field(min_length=1, max_length=64)
    seeds: tuple[Seed, ...] = Field((0,), min_length=1, max_length=1000)
    goal: Goal = Field(Goal(), description="the goal of every job; the truth is each scene's own")
    tolerance: AnyTolerance = DEFAULT_TOLERANCE
    analysis: AnalysisRequest = Field(AnalysisRequest(), description="analyses to make after each attack; default none")
    selection: Selection = Field(Selection(), description="which views are attacked")

    @field_validator("targets", mode="before")
    @classmethod
    def _names(cls, data: Any) -> Any:
        """A target that takes no question may be written as its name."""
        return [{"name": one} if isinstance(one, str) else one for one in data] if isinstance(data, list) else data

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
    def _each_once(cls, value: SceneGrid | tuple[Any, ...]) -> SceneGrid | tuple[Any, ...]:
        return value if isinstance(value, SceneGrid) else _once(value)

    def scene_list(self) -> tuple[Scene, ...]:
        """All scenes, in order."""
        return self.scenes.scenes() if isinstance(self.scenes, SceneGrid) else self.scenes


class CampaignSpec(Model):
    """Many attacks that belong together: grids, single jobs, or both."""

    name: Name = "campaign"
    grids: tuple[Grid, ...] = Field((), max_length=32)
    jobs: tuple[JobSpec, ...] = Field((), max_length=MAX_LISTED, description="jobs that are run as they are")
    reuse: bool = Field(
        True, description="take the result of an earlier job with the same request, backend, weights and versions"
    )

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


def parse(data: object) -> CampaignSpec:
    """Parses JSON data into a spec. Raises InvalidRequest for the first bad field, whose detail ends in the others."""
    try:
        return CampaignSpec.model_validate(data)
    except ValidationError as error:
        first, *others = named(error.errors(include_url=False))
        raise InvalidRequest(first.field, "; ".join([first.detail, *map(str, others)])) from error


def named(items: Iterable[Mapping[str, Any]]) -> list[InvalidRequest]:
    """One InvalidRequest for each bad field, for the items of a pydantic error."""
    return invalid_fields(items, _schema())


@cache
def _schema() -> dict[str, Any]:
    return CampaignSpec.model_json_schema()
