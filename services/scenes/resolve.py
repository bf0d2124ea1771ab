"""From a description to what renderers take: meshes, matrices, light."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import BaseModel

from services.errors import InvalidRequest
from services.scenes.description import MAP_SIZES, Scene
from services.scenes.environment import EnvironmentMap, average
from services.scenes.library import Library
from services.scenes.mesh import FIT_RADIUS, Doubles, Floats, Mesh
from services.scenes.view import camera_to_world, model_matrix, projection, visible_area

VISIBLE = 1.0
"""Pixels that an object's triangles must cover, hidden ones counted, for it to be in view."""


@dataclass(frozen=True, eq=False)
class ResolvedScene:
    """A scene with everything it names.

    meshes, models: one for each object; models are float64 [4,4], mesh to world. view: float64 [4,4], camera to world.
    projection: float64 [4,4], OpenGL. environment: float32 [rows, cols, 3], linear radiance in the directions of
    services.scenes.environment, turned and averaged down. source_map: the map before that, float32 [h, w, 3], None
    where `environment` was made otherwise. credits: lines to show with every image of the scene.
    sha256: of the canonical description and the contents of every mesh and map in it.
    """

    description: Scene
    meshes: tuple[Mesh, ...]
    models: tuple[Doubles, ...]
    view: Doubles
    projection: Doubles
    environment: Floats
    credits: list[str]
    sha256: str
    source_map: Floats | None = None

    @cached_property
    def finest_environment(self) -> Floats | None:
        """The map averaged to the largest size, as `environment` is to its own; None where that is its own.

        A texel is one direction, so that it differs also where the source has no finer texels.
        """
        if self.source_map is None or self.environment.shape[:2] == MAP_SIZES[-1]:
            return None
        return average(self.source_map, *MAP_SIZES[-1], self.description.lights.environment.rotation)

    @cached_property
    def eye(self) -> Doubles:
        """The camera's position in the world, float64 [3]."""
        return self.view[:3, 3]


def resolve(scene: Scene, library: Library) -> ResolvedScene:
    """Load what the scene names and place it.

    Raises InvalidRequest with the full path of what is wrong: "scene.objects.0.mesh" for an unknown mesh,
    "scene.objects.0" for an object of which nothing is in the frame, "scene.lights.environment.map" for an unknown map.
    """
    meshes = tuple(_mesh(library, k, placed.mesh) for k, placed in enumerate(scene.objects))
    light = scene.lights.environment
    try:
        source = library.environment(light.map)
    except InvalidRequest as error:
        raise InvalidRequest("scene.lights.environment.map", error.detail) from error
    models = tuple(model_matrix(placed) for placed in scene.objects)
    view = camera_to_world(scene.camera)
    lens = projection(scene.camera, _far(scene, view))
    for k, (mesh, model) in enumerate(zip(meshes, models, strict=True)):
        _in_view(scene, k, mesh, lens @ np.linalg.inv(view) @ model)
    return ResolvedScene(
        description=scene,
        meshes=meshes,
        models=models,
        view=view,
        projection=lens,
        environment=average(source.radiance, *light.texels, light.rotation),
        credits=_credits(meshes, source),
        sha256=fingerprint(scene, [*(mesh.sha256 for mesh in meshes), source.sha256]),
        source_map=source.radiance,
    )


def canonical_json(model: BaseModel) -> str:
    """The one JSON text of a description: all fields, sorted keys, no blanks, shortest floats, no negative zero."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        if isinstance(value, list):
            return [plain(item) for item in value]
        return 0.0 if isinstance(value, float) and value == 0 else value

    return json.dumps(plain(model.model_dump(mode="json")), sort_keys=True, separators=(",", ":"), allow_nan=False)


def fingerprint(description: BaseModel, contents: Sequence[str]) -> str:
    """SHA-256 (hex) of a description and the digests of what it names, in order."""
    return hashlib.sha256("\n".join([canonical_json(description), *contents]).encode()).hexdigest()


def _mesh(library: Library, index: int, name: str) -> Mesh:
    try:
        return library.mesh(name)
    except InvalidRequest as error:
        raise InvalidRequest(f"scene.objects.{index}.mesh", error.detail) from error


def _far(scene: Scene, view: Doubles) -> float:
    """A far plane behind everything, with room for objects that an attack moves."""
    reach = (
        float(np.linalg.norm(np.subtract(o.translation, view[:3, 3]))) + o.scale * FIT_RADIUS for o in scene.objects
    )
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


def _credits(meshes: tuple[Mesh, ...], light: EnvironmentMap) -> list[str]:
    lines = [*(mesh.credit for mesh in meshes), light.credit]
    return list(dict.fromkeys(line for line in lines if line))
