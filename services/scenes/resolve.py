"""Resolves a scene description to the data that renderers take: meshes, matrices, light."""

import hashlib
import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import sin
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from services.errors import InvalidRequest
from services.scenes import lights_map
from services.scenes.background import displayed_map, exposure_of, read_picture
from services.scenes.description import MAP_SIZES, Floor, Scene, SceneObject
from services.scenes.environment import EnvironmentMap, average
from services.scenes.floor import floor_mesh
from services.scenes.library import Library
from services.scenes.mesh import FIT_RADIUS, Doubles, Floats, Mesh
from services.scenes.metallic_roughness import with_surface
from services.scenes.view import camera_to_world, model_matrix, projection, visible_area

T = TypeVar("T")
VISIBLE = 1.0
"""Smallest area of an object's triangles in the frame, pixels, hidden ones included, for it to count as visible."""


@dataclass(frozen=True, eq=False)
class PlacedMesh:
    """A mesh where it is in the scene: one of the objects, or the floor.

    name: "object 0", or "floor"; field: its path in a request. model: float64 [4,4], mesh to world. described: the part
    of the scene's description that it is made of.
    """

    name: str
    field: str
    mesh: Mesh
    model: Doubles
    described: SceneObject | Floor

    @property
    def given_surface(self) -> bool:
        """Whether the description gives its metallic or roughness."""
        return self.described.metallic is not None or self.described.roughness is not None


@dataclass(frozen=True, eq=False)
class ResolvedScene:
    """A scene description with the loaded assets that it names.

    meshes, models: one per object, with the surface that the description gives it; models are float64 [4,4], mesh to
    world. view: float64 [4,4], camera to world. projection: float64 [4,4], OpenGL. environment: float32
    [rows, cols, 3], linear radiance in the directions of services.scenes.environment, rotated and averaged down.
    source_map: the map at full resolution, float32 [h, w, 3], or None if `environment` did not come from a library.
    map_credit: the map's attribution line, if it has one. sha256: the hex digest of the canonical description and the
    contents of every mesh and map in it.
    """

    description: Scene
    """The request's scene, but that the height of a floor is that in the world."""
    meshes: tuple[Mesh, ...]
    models: tuple[Doubles, ...]
    view: Doubles
    projection: Doubles
    environment: Floats
    map_credit: str | None
    sha256: str
    source_map: Floats | None = None
    picture: Doubles | None = None
    """The picture behind the objects, displayed values [H, W, 3] in [0,1]; None if the scene has none."""
    titles: Mapping[str, str] = field(default_factory=dict)
    """What people call the uploads among the meshes, by name."""
    measured: dict[Hashable, Any] = field(init=False, repr=False, default_factory=dict)
    """What `once` found. A changed copy of the scene begins without."""

    def once(self, what: Hashable, measure: Callable[[], T]) -> T:
        """What `measure` returns, measured once for this scene. `what` names it and all else that it depends on."""
        if what not in self.measured:
            self.measured[what] = measure()
        found: T = self.measured[what]
        return found

    @property
    def shows_map(self) -> bool:
        """Whether the environment map is what is behind the objects."""
        return self.description.background is not None and self.picture is None

    @cached_property
    def ground(self) -> Doubles:
        """What is behind the objects, displayed values: one colour [3], or an image [H, W, 3]."""
        return self.ground_from(self.projection @ np.linalg.inv(self.view))

    def ground_from(self, clip_from_world: Doubles) -> Doubles:
        """What is behind the objects before another camera [4,4]: a colour and a picture stay as they are."""
        if self.picture is not None:
            return self.picture
        if not self.shows_map:
            return np.array(self.description.ground)
        source, turn = self.source_map, self.description.lights.environment.rotation
        if source is None:  # then there is only the map as it lights the scene, which is turned already
            source, turn = self.environment, 0.0
        size = self.description.camera.size
        return displayed_map(source, exposure_of(self.environment), turn, clip_from_world, size)

    @cached_property
    def placed(self) -> tuple[PlacedMesh, ...]:
        """All that is drawn: the objects in their order, then the floor, if there is one."""
        things = self.description.objects
        placed = [
            PlacedMesh(f"object {k}", f"scene.objects.{k}", mesh, model, thing)
            for k, (mesh, model, thing) in enumerate(zip(self.meshes, self.models, things, strict=True))
        ]
        floor = self.description.floor
        if floor is not None:
            placed.append(PlacedMesh("floor", "scene.floor", floor_mesh(floor), np.eye(4), floor))
        return tuple(placed)

    @cached_property
    def finest_environment(self) -> Floats | None:
        """The map averaged to the largest size; None if `environment` has that size or there is no source map.

        A texel is treated as a single direction, so results differ even if the source has no finer texels.
        """
        if self.source_map is None or self.environment.shape[:2] == MAP_SIZES[-1]:
            return None
        return average(self.source_map, *MAP_SIZES[-1], self.description.lights.environment.rotation)

    def credits(self, lit_by_map: bool) -> list[str]:
        """Attribution lines to show with every image of the scene; the map's only if it lights the scene or is seen."""
        lines = [*(mesh.credit for mesh in self.meshes), self.map_credit if lit_by_map or self.shows_map else None]
        return list(dict.fromkeys(line for line in lines if line))

    @cached_property
    def eye(self) -> Doubles:
        """The camera's position in the world, float64 [3]."""
        return self.view[:3, 3]


def resolve(scene: Scene, library: Library) -> ResolvedScene:
    """Loads the assets that the scene names and computes their transforms.

    Raises InvalidRequest with the path of the invalid field: "scene.objects.0.mesh" for an unknown mesh,
    "scene.objects.0" for an object outside the frame or smaller than a pixel, "scene.floor" for a floor of which as
    little can be seen, "scene.lights.environment.map" for an unknown map, "scene.background.image" for what is no image
    of the camera's size.
    """
    meshes = _meshes(library, scene)
    light = scene.lights.environment
    source = _environment(library, scene)
    models = tuple(model_matrix(placed) for placed in scene.objects)
    sha256 = fingerprint(scene, [*(mesh.sha256 for mesh in meshes), source.sha256])
    scene = _standing(scene, meshes, models)
    view = camera_to_world(scene.camera)
    lens = projection(scene.camera, _far(scene, view))
    for k, (mesh, model) in enumerate(zip(meshes, models, strict=True)):
        _in_view(scene, k, mesh, lens @ np.linalg.inv(view) @ model)
    if scene.floor is not None:
        _floor_in_view(scene, scene.floor, lens @ np.linalg.inv(view))
    return ResolvedScene(
        description=scene,
        meshes=meshes,
        models=models,
        view=view,
        projection=lens,
        environment=_averaged(source, *light.texels, light.rotation),
        map_credit=source.credit,
        sha256=sha256,
        source_map=source.radiance,
        picture=_picture(scene),
        titles=library.titles(placed.mesh for placed in scene.objects),
    )


@lru_cache(maxsize=8)
def _averaged(source: EnvironmentMap, rows: int, cols: int, rotation: float) -> Floats:
    return average(source.radiance, rows, cols, rotation)


def canonical_json(model: BaseModel) -> str:
    """Returns the canonical JSON of a description: all fields, sorted keys, no blanks, shortest floats, no −0."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list):
            return [plain(item) for item in value]
        return 0.0 if isinstance(value, float) and value == 0 else value

    return json.dumps(plain(model.model_dump(mode="json")), sort_keys=True, separators=(",", ":"), allow_nan=False)


def fingerprint(description: BaseModel, contents: Sequence[str]) -> str:
    """Returns the SHA-256 (hex) of a description and of the digests `contents` of the assets it names, in order."""
    return hashlib.sha256("\n".join([canonical_json(description), *contents]).encode()).hexdigest()


def _meshes(library: Library, scene: Scene) -> tuple[Mesh, ...]:
    """The objects' meshes; objects of the same mesh and surface share one, so that it is uploaded once."""
    made: dict[tuple[str, float | None, float | None], Mesh] = {}
    for k, thing in enumerate(scene.objects):
        key = thing.mesh, thing.metallic, thing.roughness
        if key not in made:
            made[key] = with_surface(_mesh(library, k, thing.mesh), thing.metallic, thing.roughness)
    return tuple(made[thing.mesh, thing.metallic, thing.roughness] for thing in scene.objects)


def _environment(library: Library, scene: Scene) -> EnvironmentMap:
    name = scene.lights.environment.map
    if name == lights_map.NAME:
        return lights_map.lights_map(scene.lights)
    try:
        return library.environment(name)
    except InvalidRequest as error:
        raise InvalidRequest("scene.lights.environment.map", error.detail) from error


def _picture(scene: Scene) -> Doubles | None:
    if scene.background is None or scene.background.image is None:
        return None
    try:
        return read_picture(scene.background.image, scene.camera.size)
    except InvalidRequest as error:
        raise InvalidRequest("scene.background.image", error.detail) from error


def _standing(scene: Scene, meshes: Sequence[Mesh], models: Sequence[Doubles]) -> Scene:
    """The scene with the height of its floor in the world, where it is given above the objects' lowest point."""
    if scene.floor is None or not scene.floor.contact:
        return scene
    lowest = min(
        float((part.vertices * model[1, :3]).sum(axis=1).min() + model[1, 3])
        for mesh, model in zip(meshes, models, strict=True)
        for part in mesh.parts
    )
    floor = scene.floor.model_copy(update={"height": lowest + scene.floor.height, "contact": False})
    return scene.model_copy(update={"floor": floor})


def _mesh(library: Library, index: int, name: str) -> Mesh:
    try:
        return library.mesh(name)
    except InvalidRequest as error:
        raise InvalidRequest(f"scene.objects.{index}.mesh", error.detail) from error


def _far(scene: Scene, view: Doubles) -> float:
    """Returns the distance of a far plane behind all objects, with room for objects that an attack moves, and behind
    the floor."""
    reach = [
        float(np.linalg.norm(np.subtract(o.translation, view[:3, 3]))) + o.scale * FIT_RADIUS for o in scene.objects
    ]
    if scene.floor is not None:
        corner = np.array([scene.floor.size / 2, scene.floor.height, scene.floor.size / 2])
        reach.append(float(np.linalg.norm(np.abs(view[:3, 3]) + np.abs(corner))))
    return 2 * max(reach) + 10


def _in_view(scene: Scene, index: int, mesh: Mesh, to_clip: Doubles) -> None:
    area = visible_area(mesh, to_clip, scene.camera.size, VISIBLE)
    if area >= VISIBLE:
        return
    placed = scene.objects[index]
    why = "it is too small: less than a pixel of it shows" if area > 0 else "nothing of it is inside the frame"
    raise InvalidRequest(
        f"scene.objects.{index}",
        f"out of view: {why}; the camera looks at the origin from a distance of {scene.camera.distance:g}, and the "
        f"object of scale {placed.scale:g} is at ({', '.join(f'{x:g}' for x in placed.translation)})",
    )


def _floor_in_view(scene: Scene, floor: Floor, to_clip: Doubles) -> None:
    if visible_area(floor_mesh(floor), to_clip, scene.camera.size, VISIBLE) < VISIBLE:
        raise InvalidRequest(
            "scene.floor",
            f"out of view: less than a pixel of it shows; it is {floor.size:g} wide at a height of {floor.height:g}, "
            f"and the camera is at a height of {scene.camera.distance * sin(scene.camera.elevation):g}",
        )
