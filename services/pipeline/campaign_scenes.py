"""The scenes of a campaign's grid: meshes × views, each a scene with one object. This module does not import torch."""

from itertools import zip_longest
from math import pi
from random import Random
from typing import Annotated, Self, TypeVar

from pydantic import Field, field_validator, model_validator

from services.attacks.spec import Seed
from services.names import reference
from services.scenes import furniture_kinds
from services.scenes.description import Angle, Camera, Colour, Lights, Model, Scene, SceneObject
from services.suggestions import there_are

MAX_LISTED = 20_000
"""Largest number of scenes, meshes or jobs that a campaign may list."""

Listed = TypeVar("Listed")


def once(value: tuple[Listed, ...]) -> tuple[Listed, ...]:
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

    meshes: tuple[Annotated[str, Field(min_length=1, max_length=200), reference("mesh")], ...] = Field(
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
    material: Annotated[str, reference("material")] = Field(
        "matte", max_length=64, description="DSBRDF preset of the torch renderer"
    )
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
        return value if isinstance(value, RandomViews) else once(value)

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
