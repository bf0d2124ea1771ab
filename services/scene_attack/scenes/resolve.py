"""Resolves a scene description to the data that renderers take: meshes with their surfaces, floor, background,
matrices, light.
"""

import base64
import binascii
import hashlib
import json
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from math import pi, sin
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

from scene_attack.errors import InvalidRequest, at_field
from scene_attack.scenes.description import MAP_SIZES, Floor, Scene, SceneObject
from scene_attack.scenes.environment import LIGHTS, EnvironmentMap, average, lights_map
from scene_attack.scenes.image_file import to_display
from scene_attack.scenes.library import Library
from scene_attack.scenes.mesh import (
    FIT_RADIUS,
    AlphaMode,
    Doubles,
    Floats,
    MapName,
    Mesh,
    MetallicRoughness,
    Part,
    TextureMap,
)
from scene_attack.scenes.reading.isolated import reader
from scene_attack.scenes.solids import OPAQUE_FROM, has_holes
from scene_attack.scenes.view import camera_to_world, model_matrix, projection, visible_area

METALLIC, ROUGHNESS = 0.0, 0.5
"""Metallic and roughness of a surface for which only the other one is given."""
REPEAT = (10497, 10497)
"""OpenGL's wrap modes of a texture that repeats, as those of files without sampler settings do."""


def with_surface(mesh: Mesh, metallic: float | None, roughness: float | None) -> Mesh:
    """Returns the mesh with this metallic and roughness, both in [0,1], at every point; itself if both are None.

    Base colours, textures and opacities stay. A glTF material keeps its other settings and loses the map that varied
    the two. Other surfaces become glTF materials that are seen from both sides, as they were.
    """
    if metallic is None and roughness is None:
        return mesh
    finish = METALLIC if metallic is None else metallic, ROUGHNESS if roughness is None else roughness
    return replace(mesh, parts=tuple(with_surface_of_part(part, *finish) for part in mesh.parts))


def with_surface_of_part(part: Part, metallic: float, roughness: float) -> Part:
    """Does for one part of a mesh what `with_surface` does for all."""
    own = part.metallic_roughness
    if own is not None:
        maps: dict[MapName, TextureMap] = {k: texture for k, texture in own.maps.items() if k != "metallic_roughness"}
        return replace(
            part, metallic_roughness=replace(own, metallic=metallic, roughness=roughness, maps=maps, given=True)
        )
    count = len(part.vertices)
    return replace(
        part,
        uv=np.zeros((count, 2), np.float32) if part.uv is None else part.uv,
        texture=None,
        metallic_roughness=MetallicRoughness(
            metallic=metallic,
            roughness=roughness,
            emissive=(0.0, 0.0, 0.0),
            alpha_mode=_alpha_mode(part),
            alpha_cutoff=0.5,
            double_sided=True,
            normal_scale=1.0,
            occlusion_strength=1.0,
            maps=_maps(part),
            tangents=np.zeros((count, 4), np.float32),
            second_uv=np.zeros((count, 2), np.float32),
            vertex_colors=np.ones((count, 4), np.float32),
            given=True,
        ),
    )


def _maps(part: Part) -> Mapping[MapName, TextureMap]:
    if part.texture is None or part.uv is None:
        return {}
    texels, mode = part.texture, _alpha_mode(part)
    if mode == "BLEND":  # whose opacity would be multiplied by the texels'
        texels = texels.copy()
        texels[..., 3] = np.where(texels[..., 3] < OPAQUE_FROM, 0, 255)
    return {"base_color": TextureMap(texels, 0, REPEAT)}


def _alpha_mode(part: Part) -> AlphaMode:
    if part.color[3] < 1:
        return "BLEND"
    return "MASK" if has_holes(part) else "OPAQUE"


def floor_mesh(floor: Floor) -> Mesh:
    """Returns two triangles in world space, white, that face +y."""
    half = floor.size / 2
    corners = [(-half, floor.height, half), (half, floor.height, half), (half, floor.height, -half)]
    corners.append((-half, floor.height, -half))
    part = Part(
        vertices=np.array(corners, np.float32),
        normals=np.tile(np.array([0.0, 1.0, 0.0], np.float32), (4, 1)),
        faces=np.array([(0, 1, 2), (0, 2, 3)], np.int32),
    )
    digest = hashlib.sha256(part.vertices.tobytes()).hexdigest()
    return with_surface(Mesh(parts=(part,), sha256=digest, credit=None), floor.metallic, floor.roughness)


DISPLAYED_WHITE = 0.9
"""Linear value of the brightest channel of the white Lambertian surface that a map lights most; the torch renderer's
exposure is the same, so that objects and background fit together."""
EXPOSURE_NORMALS = (16, 32)
"""Rows and columns of the grid of normals that are searched for that surface."""
BACKGROUND_SAMPLES = 2
"""Rays along each side of a pixel; their radiances are averaged."""


def read_picture(text: str, size: tuple[int, int]) -> Doubles:
    """Returns a PNG, JPEG or WebP file in base64 as displayed values in [0,1], float64 [H, W, 3].

    Raises InvalidRequest("image") unless it is such an image of height and width `size`.
    """
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InvalidRequest("image", "it is not base64") from error
    return np.asarray(reader().read_image(data, size) / 255)


def exposure_of(environment: Floats) -> float:
    """Returns the factor from a map's radiance [rows, cols, 3] to linear display values; 0 if it is black.

    The map is the one that lights the scene, averaged down to its size.
    """
    rows, cols = environment.shape[:2]
    strongest = float(environment.max())
    if strongest == 0:
        return 0.0
    edges = np.cos(np.linspace(0, pi, rows + 1))
    solid = np.repeat((edges[:-1] - edges[1:]) * (2 * pi / cols), cols)
    power = (environment.astype(np.float64) / strongest).reshape(-1, 3) * solid[:, None]
    cosines = (_directions(*EXPOSURE_NORMALS) @ _directions(rows, cols).T).clip(min=0)
    return DISPLAYED_WHITE / float((cosines @ power / pi).max()) / strongest


def _directions(rows: int, cols: int) -> Doubles:
    theta, phi = np.meshgrid(
        (np.arange(rows) + 0.5) * pi / rows, (np.arange(cols) + 0.5) * 2 * pi / cols, indexing="ij"
    )
    vectors = np.stack((np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)), axis=-1)
    return vectors.reshape(-1, 3)


def displayed_map(
    radiance: Floats, exposure: float, turn: float, clip_from_world: Doubles, size: tuple[int, int]
) -> Doubles:
    """Returns a map as a camera sees it, displayed values in [0,1], float64 [H, W, 3], multiples of 1/255.

    radiance: the map [rows, cols, 3], interpolated linearly between texel centres. turn: about +y, radians, as
    `environment.average` turns it. clip_from_world: float64 [4,4]. size: height and width H, W.
    """
    height, width = size
    x = (np.arange(width * BACKGROUND_SAMPLES) + 0.5) * 2 / (width * BACKGROUND_SAMPLES) - 1
    y = 1 - (np.arange(height * BACKGROUND_SAMPLES) + 0.5) * 2 / (height * BACKGROUND_SAMPLES)
    down, right = np.meshgrid(y, x, indexing="ij")
    ends = []
    for depth in (-1.0, 1.0):  # on the near and on the far plane
        points = np.stack((right, down, np.full_like(right, depth), np.ones_like(right)), axis=-1)
        points = points @ np.linalg.inv(clip_from_world).T
        ends.append(points[..., :3] / points[..., 3:])
    rays = ends[1] - ends[0]
    seen = (
        _looked_up(radiance, rays, turn)
        .reshape(height, BACKGROUND_SAMPLES, width, BACKGROUND_SAMPLES, 3)
        .mean(axis=(1, 3))
    )
    return np.asarray(np.round(to_display(exposure * seen) * 255) / 255)


def _looked_up(radiance: Floats, rays: Doubles, turn: float) -> Doubles:
    """The radiance [..., 3] of a map in the directions of rays [..., 3] of any length."""
    rows, cols = radiance.shape[:2]
    across = np.hypot(rays[..., 0], rays[..., 2])
    row = np.arctan2(across, rays[..., 1]) / pi * rows - 0.5
    col = np.mod(np.arctan2(rays[..., 0], rays[..., 2]) - turn, 2 * pi) / (2 * pi) * cols - 0.5
    top, left = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    down, right = (row - top)[..., None], (col - left)[..., None]
    above, below = top.clip(0, rows - 1), (top + 1).clip(0, rows - 1)
    before, after = np.mod(left, cols), np.mod(left + 1, cols)
    upper = (1 - right) * radiance[above, before] + right * radiance[above, after]
    lower = (1 - right) * radiance[below, before] + right * radiance[below, after]
    return np.asarray((1 - down) * upper + down * lower)


T = TypeVar("T")
VISIBLE_PIXELS = 1.0
"""Smallest area of an object's triangles in the frame, pixels, hidden ones included, for it to count as visible."""


@dataclass(frozen=True, eq=False)
class PlacedMesh:
    """A mesh where it is in the scene: one of the objects, something fixed, or the floor.

    name: "object 0", "fixed 0" or "floor"; field: its path in a request. model: float64 [4,4], mesh to world.
    described: the part of the scene's description that it is made of.
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
    world. fixed: a mesh for each thing that no attack changes. view: float64 [4,4], camera to world. projection:
    float64 [4,4], OpenGL. environment: float32 [rows, cols, 3], linear radiance in the directions of
    scene_attack.scenes.environment, rotated and averaged down. source_map: the map at full resolution, float32 [h, w,
    3], or None if `environment` did not come from a library. map_credit: the map's attribution line, if it has one.
    sha256: the hex digest of the canonical description and the contents of every mesh and map in it.
    """

    description: Scene
    """The request's scene, with the height of its floor in the world and the objects that stand on it where they do."""
    meshes: tuple[Mesh, ...]
    models: tuple[Doubles, ...]
    view: Doubles
    projection: Doubles
    environment: Floats
    map_credit: str | None
    sha256: str
    source_map: Floats | None = None
    fixed: tuple[Mesh, ...] = ()
    picture: Doubles | None = None
    """The picture behind the objects, displayed values [H, W, 3] in [0,1]; None if the scene has none."""
    titles: Mapping[str, str] = field(default_factory=dict)
    """Titles that people gave the uploads among the meshes, by name."""
    measured: dict[Hashable, Any] = field(init=False, repr=False, default_factory=dict)
    """Results kept by `once`. A changed copy of the scene begins without any."""

    def once(self, what: Hashable, measure: Callable[[], T]) -> T:
        """Returns the result of `measure`, which is called once for this scene. `what` names the result and all else
        that it depends on.
        """
        if what not in self.measured:
            self.measured[what] = measure()
        value: T = self.measured[what]
        return value

    @property
    def shows_map(self) -> bool:
        """Whether the environment map is seen behind the objects."""
        return self.description.background is not None and self.picture is None

    @cached_property
    def ground(self) -> Doubles:
        """The background behind the objects, displayed values: one colour [3], or an image [H, W, 3]."""
        return self.ground_from(self.projection @ np.linalg.inv(self.view))

    def ground_from(self, clip_from_world: Doubles) -> Doubles:
        """The background that another camera [4,4] sees; a colour and a picture stay as they are."""
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
        """Everything that is drawn: the objects in their order, what is fixed, and then the floor if there is one."""
        things = self.description.objects
        placed = [
            PlacedMesh(f"object {k}", f"scene.objects.{k}", mesh, model, thing)
            for k, (mesh, model, thing) in enumerate(zip(self.meshes, self.models, things, strict=True))
        ]
        placed += [
            PlacedMesh(f"fixed {k}", f"scene.fixed.{k}", mesh, model_matrix(thing), thing)
            for k, (mesh, thing) in enumerate(zip(self.fixed, self.description.fixed, strict=True))
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
        lines = [
            *(mesh.credit for mesh in (*self.meshes, *self.fixed)),
            self.map_credit if lit_by_map or self.shows_map else None,
        ]
        return list(dict.fromkeys(line for line in lines if line))

    @cached_property
    def eye(self) -> Doubles:
        """The camera's position in the world, float64 [3]."""
        return self.view[:3, 3]


def resolve(scene: Scene, library: Library) -> ResolvedScene:
    """Loads the assets that the scene names and computes their transforms.

    Raises InvalidRequest with the path of the invalid field: "scene.objects.0.mesh" or "scene.fixed.0.mesh" for an
    unknown mesh, "scene.objects.0" for an object outside the frame or smaller than a pixel, "scene.floor" for a floor
    of which as little can be seen, "scene.lights.environment.map" for an unknown map, "scene.background.image" for what
    is no image of the camera's size.
    """
    everything = _meshes(library, scene)
    meshes, fixed = everything[: len(scene.objects)], everything[len(scene.objects) :]
    light = scene.lights.environment
    source = _environment(library, scene)
    drawn = scene.model_copy(update={"source": None})  # which says again what the other fields say
    sha256 = fingerprint(drawn, [*(mesh.sha256 for mesh in everything), source.sha256])
    scene = _standing(scene, meshes)
    models = tuple(model_matrix(placed) for placed in scene.objects)
    view = camera_to_world(scene.camera)
    lens = projection(scene.camera, far_plane(scene, view))
    for k, (mesh, model) in enumerate(zip(meshes, models, strict=True)):
        _in_view(scene, k, mesh, lens @ np.linalg.inv(view) @ model)
    if scene.floor is not None:
        _floor_in_view(scene, scene.floor, lens @ np.linalg.inv(view))
    return ResolvedScene(
        description=scene,
        meshes=meshes,
        fixed=fixed,
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
    """The meshes of the objects, then of what is fixed; those of the same mesh and surface share one, so that it is
    uploaded once."""
    things = [(f"scene.objects.{k}", thing) for k, thing in enumerate(scene.objects)]
    things += [(f"scene.fixed.{k}", thing) for k, thing in enumerate(scene.fixed)]
    meshes: dict[tuple[str, float | None, float | None], Mesh] = {}
    for place, thing in things:
        key = thing.mesh, thing.metallic, thing.roughness
        if key not in meshes:
            with at_field(f"{place}.mesh"):
                mesh = library.mesh(thing.mesh)
            meshes[key] = with_surface(mesh, thing.metallic, thing.roughness)
    return tuple(meshes[thing.mesh, thing.metallic, thing.roughness] for _, thing in things)


def _environment(library: Library, scene: Scene) -> EnvironmentMap:
    name = scene.lights.environment.map
    if name == LIGHTS:
        return lights_map(scene.lights)
    with at_field("scene.lights.environment.map"):
        return library.environment(name)


def _picture(scene: Scene) -> Doubles | None:
    if scene.background is None or scene.background.image is None:
        return None
    with at_field("scene.background.image"):
        return read_picture(scene.background.image, scene.camera.size)


def _standing(scene: Scene, meshes: Sequence[Mesh]) -> Scene:
    """The scene with its objects on the floor and the floor's height in the world, where it is given above the objects'
    lowest point: the object that has it stays, and the others are lowered as far."""
    if scene.floor is None or not scene.floor.contact:
        return scene
    feet = [_lowest(mesh, model_matrix(thing)) for mesh, thing in zip(meshes, scene.objects, strict=True)]
    lowest = min(feet)
    objects = []
    for thing, foot in zip(scene.objects, feet, strict=True):
        x, y, z = thing.translation
        objects.append(thing.model_copy(update={"translation": (x, y - (foot - lowest), z)}))
    floor = scene.floor.model_copy(update={"height": lowest + scene.floor.height, "contact": False})
    return scene.model_copy(update={"objects": tuple(objects), "floor": floor})


def _lowest(mesh: Mesh, model: Doubles) -> float:
    """The least y of a mesh in the world."""
    return min(float((part.vertices * model[1, :3]).sum(axis=1).min() + model[1, 3]) for part in mesh.parts)


def far_plane(scene: Scene, view: Doubles) -> float:
    """Returns the distance of the far plane: the camera's own, or one behind all that is in the scene, with room for
    objects that an attack moves, and behind the floor."""
    if scene.camera.far is not None:
        return scene.camera.far
    reach = [
        float(np.linalg.norm(np.subtract(o.translation, view[:3, 3]))) + o.scale * FIT_RADIUS
        for o in (*scene.objects, *scene.fixed)
    ]
    if scene.floor is not None:
        corner = np.array([scene.floor.size / 2, scene.floor.height, scene.floor.size / 2])
        reach.append(float(np.linalg.norm(np.abs(view[:3, 3]) + np.abs(corner))))
    return 2 * max(reach) + 10


def _in_view(scene: Scene, index: int, mesh: Mesh, to_clip: Doubles) -> None:
    area = visible_area(mesh, to_clip, scene.camera.size, VISIBLE_PIXELS)
    if area >= VISIBLE_PIXELS:
        return
    placed = scene.objects[index]
    why = "it is too small: less than a pixel of it shows" if area > 0 else "nothing of it is inside the frame"
    node = placed.mesh.partition("#")[2]
    hint = f"; it is node #{node} of the file, and `source.change` names those that the camera sees" if node else ""
    raise InvalidRequest(
        f"scene.objects.{index}",
        f"out of view: {why}; the camera looks at the origin from a distance of {scene.camera.distance:g}, and the "
        f"object of scale {placed.scale:g} is at ({', '.join(f'{x:g}' for x in placed.translation)}){hint}",
    )


def _floor_in_view(scene: Scene, floor: Floor, to_clip: Doubles) -> None:
    if visible_area(floor_mesh(floor), to_clip, scene.camera.size, VISIBLE_PIXELS) < VISIBLE_PIXELS:
        raise InvalidRequest(
            "scene.floor",
            f"out of view: less than a pixel of it shows; it is {floor.size:g} wide at a height of {floor.height:g}, "
            f"and the camera is at a height of {scene.camera.distance * sin(scene.camera.elevation):g}",
        )
