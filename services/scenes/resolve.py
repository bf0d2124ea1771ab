"""Resolves a scene description to the data that renderers take: meshes, matrices, light."""

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
from services.scenes.environment import average
from services.scenes.library import Library
from services.scenes.mesh import FIT_RADIUS, Doubles, Floats, Mesh
from services.scenes.view import camera_to_world, model_matrix, projection, visible_area

VISIBLE = 1.0
"""Smallest area of an object's triangles in the frame, pixels, hidden ones included, for it to count as visible."""


@dataclass(frozen=True, eq=False)
class ResolvedScene:
    """A scene description with the loaded assets that it names.

    meshes, models: one per object; models are float64 [4,4], mesh to world. view: float64 [4,4], camera to world.
    projection: float64 [4,4], OpenGL. environment: float32 [rows, cols, 3], linear radiance in the directions of
    services.scenes.environment, rotated and averaged down. source_map: the map at full resolution, float32 [h, w, 3],
    or None if `environment` did not come from a library. map_credit: the map's attribution line, if it has one.
    sha256: the hex digest of the canonical description and the contents of every mesh and map in it.
    """

    description: Scene
    meshes: tuple[Mesh, ...]
    models: tuple[Doubles, ...]
    view: Doubles
    projection: Doubles
    environment: Floats
    map_credit: str | None
    sha256: str
    source_map: Floats | None = None

    @cached_property
    def finest_environment(self) -> Floats | None:
        """The map averaged to the largest size; None if `environment` has that size or there is no source map.

        A texel is treated as a single direction, so results differ even if the source has no finer texels.
        """
        if self.source_map is None or self.environment.shape[:2] == MAP_SIZES[-1]:
            return None
        return average(self.source_map, *MAP_SIZES[-1], self.description.lights.environment.rotation)

    def credits(self, lit_by_map: bool) -> list[str]:
        """Attribution lines to show with every image of the scene; the map's only if the map lights the scene."""
        lines = [*(mesh.credit for mesh in self.meshes), self.map_credit if lit_by_map else None]
        return list(dict.fromkeys(line for line in lines if line))

    @cached_property
    def eye(self) -> Doubles:
        """The camera's position in the world, float64 [3]."""
        return self.view[:3, 3]


def resolve(scene: Scene, library: Library) -> ResolvedScene:
    """Loads the assets that the scene names and computes their transforms.

    Raises InvalidRequest with the path of the invalid field: "scene.objects.0.mesh" for an unknown mesh,
    "scene.objects.0" for an object outside the frame or smaller than a pixel, "scene.lights.environment.map" for an
    unknown map.
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
        map_credit=source.credit,
        sha256=fingerprint(scene, [*(mesh.sha256 for mesh in meshes), source.sha256]),
        source_map=source.radiance,
    )


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


def _mesh(library: Library, index: int, name: str) -> Mesh:
    try:
        return library.mesh(name)
    except InvalidRequest as error:
        raise InvalidRequest(f"scene.objects.{index}.mesh", error.detail) from error


def _far(scene: Scene, view: Doubles) -> float:
    """Returns the distance of a far plane behind all objects, with room for objects that an attack moves."""
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
