"""A scene in a file, `scene.source` of the format "file": camera, objects, what is fixed, and lights follow from it.

The file's scene is looked up where the request is validated with a context (`strict.Names`); a stored request has all
that followed, and needs no file. A file's metres become scene units by one factor about one point, which is on the line
of sight of its camera: turning is left out, since +y is up in both. Light intensities become energies by one factor
too.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from math import asin, atan2, cos
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, ModelWrapValidatorHandler, PrivateAttr, ValidationInfo, model_validator

from scene_attack.errors import InvalidRequest
from scene_attack.scenes.description import (
    DISTANCE,
    MAX_LIGHTS,
    Camera,
    DirectionalLight,
    Environment,
    GivenMesh,
    Lights,
    PointLight,
    Scene,
    SceneObject,
    SpotLight,
)
from scene_attack.scenes.environment import LIGHTS
from scene_attack.scenes.mesh import FIT_RADIUS, Doubles
from scene_attack.scenes.scene_file import (
    Extent,
    FileCamera,
    FileLight,
    SceneFile,
    Vector,
    mesh_of_node,
    mesh_of_rest,
    vector,
)
from scene_attack.scenes.source import Source, register_source
from scene_attack.scenes.view import camera_pose
from scene_attack.strict import Several, absent
from scene_attack.text import did_you_mean

MAX_OBJECTS = 16
"""Largest number of objects of a scene."""
REACH = 99.0
"""Largest coordinate and scale here; a scene may have 100, to which rounding adds."""
NEAREST = 0.05
"""Smallest distance of a scene's camera."""
IRRADIANCE = 30 / 9
"""Sum of the irradiances that the file's lights have where the objects are: a default point light's at distance 3."""
SMALLEST = 1e-3
"""Smallest scale of an object."""
MAX_ENERGY = 9_900
"""Largest energy of a light here; it may have 10,000."""
DARK = 1e-30
"""Largest intensity of a light that counts as none: no finite exposure makes it seen."""
MAX_LISTED = 20
"""Nodes that a message lists."""


@register_source("file")
class FileScene(Source):
    """The scene in a glTF file, or what of it is attacked. Lengths are metres in the file, and scene units here."""

    format: Literal["file"]
    file: GivenMesh = Field(description="the file: a path of the machine that sends it, or the id of an upload")
    camera: Annotated[str, Field(max_length=200)] | None = Field(
        default=None,
        description="name of the file's camera; null: its first, or if it has none one that sees the objects",
    )
    change: Several[Annotated[str, Field(min_length=1, max_length=200)]] | None = Field(
        default=None,
        max_length=64,
        description="names of the nodes that an attack may change, each an object with all below it; `*` is any text, "
        "`#12` the node with that number in `scene-attack scene show`; null: all, if they are few",
    )
    scale: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None, exclude_if=absent, description="scene units in a metre; filled in"
    )
    exposure: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        default=None,
        exclude_if=absent,
        description="energy of a light of one lux, or of one candela before `scale`; filled in if the file has lights",
    )
    missing: Several[Annotated[str, Field(max_length=400)]] | None = Field(
        default=None,
        max_length=64,
        exclude_if=absent,
        description="what of the file is not in the scene; filled in",
    )
    _follows: dict[str, Any] | None = PrivateAttr(default=None)

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo) -> Self:
        source = handler(data)
        if source.scale is not None or not info.context or "scene" not in info.context:
            return source
        try:
            found = scene_of(info.context["scene"](source.file), source.file, source.camera, source.change)
        except InvalidRequest as error:
            raise ValueError(str(error)) from error  # it names a field of the source
        stated = {"scale": found.scale, "exposure": found.exposure, "missing": tuple(found.missing) or None}
        source = source.model_copy(update=stated)
        source._follows = found.fields
        return source

    def filled_in(self) -> Self:
        """Returns itself: a validation that can look up the file has filled it in."""
        return self

    def follows(self) -> dict[str, Any]:
        """Returns camera, objects, what is fixed, and lights, once. Raises InvalidRequest("file") if it is not read."""
        fields, self._follows = self._follows, None  # a stored request, which has none, is equal
        if fields is None:
            raise InvalidRequest("file", "it is read where a request is sent; give the scene as data there")
        return fields

    def left_out(self) -> Sequence[str]:
        """Returns the filled-in `missing`."""
        return self.missing or ()

    def check(self, scene: Scene) -> None:
        """Any scene may be made of a file's."""


class FollowingScene(NamedTuple):
    """Fields of a scene that follow from a file, and what `FileScene` states of them."""

    fields: dict[str, Any]
    scale: float
    exposure: float | None
    missing: list[str]


class _View(NamedTuple):
    """A view in metres: the origin of the scene, the camera's distance from it, and its other fields."""

    origin: Doubles
    distance: float
    fields: dict[str, Any]


def scene_of(scene: SceneFile, file: str, camera: str | None, change: Sequence[str] | None) -> FollowingScene:
    """Returns what follows from the scene in the upload `file`; `camera` and `change` as in `FileScene`.

    Raises InvalidRequest("camera" or "change") for names that there are not, for nothing or too much to change, and for
    what does not fit into a scene.
    """
    if scene.own is not None and camera is None and change is None:
        return FollowingScene(dict(scene.own), 1.0, None, list(scene.left_out))
    picked = _picked(scene, change)
    objects = {mesh_of_node(file, node): scene.nodes[node].extent for node in picked}
    fixed = () if set(scene.parts) <= scene.below(picked) else (mesh_of_rest(file, picked),)
    return _following(scene, _camera(scene, camera), objects, fixed)


def whole_scene(scene: SceneFile, file: str) -> FollowingScene:
    """Returns a scene of all that is in the upload `file`, as one object, seen by its first camera."""
    if scene.own is not None:
        return scene_of(scene, file, None, None)
    return _following(scene, _camera(scene, None), {file: scene.extent}, ())


def _following(
    scene: SceneFile, camera: FileCamera | None, objects: Mapping[str, Extent | None], fixed: Sequence[str]
) -> FollowingScene:
    """What follows for meshes of the file where it has them; those that are fixed are in the whole file's frame."""
    drawn = {mesh: extent for mesh, extent in objects.items() if extent is not None}
    around = _union(drawn.values())
    view = _view(camera, around)
    assert scene.extent is not None
    scale = _scale(view, [scene.extent, *drawn.values()])
    frame = _Frame(view.origin, scale)
    fields: dict[str, Any] = {
        "camera": Camera(**view.fields, distance=scale * view.distance),
        "objects": tuple(frame.placed(mesh, extent) for mesh, extent in drawn.items()),
    }
    if fixed:
        fields["fixed"] = tuple(frame.placed(mesh, scene.extent) for mesh in fixed)
    lit, exposure, dark = _lights(scene.lights, around, frame)
    return FollowingScene(fields | lit, scale, exposure, [*dark, *scene.left_out])


class _Frame(NamedTuple):
    """From a file's metres to scene units: the point that becomes the origin, and the scale."""

    origin: Doubles
    scale: float

    def point(self, metres: Vector) -> Vector:
        return vector(self.scale * (np.array(metres) - self.origin))

    def placed(self, mesh: str, extent: Extent) -> SceneObject:
        """A mesh where it is in the file; its own frame has the file's axes."""
        size = self.scale * extent.radius / FIT_RADIUS
        if size < SMALLEST:
            detail = f"{mesh.partition('#')[2]} is too small to be seen: {2 * extent.radius:.3g} m wide"
            raise InvalidRequest("change", f"the node #{detail}")
        return SceneObject(mesh=mesh, translation=self.point(extent.centre), scale=size)


def _picked(scene: SceneFile, change: Sequence[str] | None) -> list[int]:
    """The nodes that may change, none of them below another."""
    drawn = [k for k, node in enumerate(scene.nodes) if node.extent is not None]
    if change is None:
        picked = things(scene)
        if len(picked) > MAX_OBJECTS:
            raise InvalidRequest(
                "change",
                f"the file has {len(picked):,} things, of which {MAX_OBJECTS} may change; name some of "
                + _listed(scene, picked),
            )
        return picked
    chosen: set[int] = set()
    for k, pattern in enumerate(change):
        matching = {node for node in drawn if pattern == f"#{node}" or _matches(scene.nodes[node].name, pattern)}
        if not matching:
            raise InvalidRequest(f"change.{k}", _unknown(scene, pattern, drawn))
        chosen |= matching
    picked = [node for node in sorted(chosen) if not _is_below(scene, node, chosen)]
    if not 0 < len(picked) <= MAX_OBJECTS:
        raise InvalidRequest("change", f"it names {len(picked):,} nodes; from 1 to {MAX_OBJECTS} may change")
    return picked


def _matches(name: str, pattern: str) -> bool:
    """Whether a name is a pattern, in which `*` alone has a meaning."""
    return fnmatchcase(name, re.sub(r"[\[?]", r"[\g<0>]", pattern))


def things(scene: SceneFile) -> list[int]:
    """The nodes that are objects where none is named: the roots with triangles, or if there is one alone, which has no
    triangles of its own, those below it."""
    level = [k for k, node in enumerate(scene.nodes) if node.parent is None and node.extent is not None]
    while len(level) == 1 and not scene.nodes[level[0]].triangles:
        level = [k for k, node in enumerate(scene.nodes) if node.parent == level[0] and node.extent is not None]
    return level


def _is_below(scene: SceneFile, node: int, others: set[int]) -> bool:
    parent = scene.nodes[node].parent
    while parent is not None:
        if parent in others:
            return True
        parent = scene.nodes[parent].parent
    return False


def _unknown(scene: SceneFile, name: str, drawn: list[int]) -> str:
    if any(name == f"#{k}" or node.name == name for k, node in enumerate(scene.nodes)):
        return f"nothing of the node {name!r} can be drawn"
    known = list(dict.fromkeys(scene.nodes[k].name for k in drawn if scene.nodes[k].name))
    return f"there is no node {name!r} in the file{did_you_mean(name, known) or f'; there are {_listed(scene, drawn)}'}"


def _listed(scene: SceneFile, nodes: Sequence[int]) -> str:
    names = list(dict.fromkeys(map(scene.label, nodes)))
    more = (
        f" and {len(names) - MAX_LISTED:,} more, which `scene-attack scene show` lists"
        if len(names) > MAX_LISTED
        else ""
    )
    return ", ".join(map(repr, names[:MAX_LISTED])) + more


def _union(extents: Iterable[Extent]) -> Extent:
    """The extent of several; its radius is that of the ball about its middle that holds their balls."""
    known = list(extents)
    centres = np.array([extent.centre for extent in known])
    halves = np.array([extent.size for extent in known]) / 2
    low, high = (centres - halves).min(axis=0), (centres + halves).max(axis=0)
    middle = (low + high) / 2
    radius = max(float(np.linalg.norm(np.subtract(extent.centre, middle))) + extent.radius for extent in known)
    return Extent(centre=vector(middle), size=vector(high - low), radius=radius)


def _camera(scene: SceneFile, name: str | None) -> FileCamera | None:
    if name is None:
        return scene.cameras[0] if scene.cameras else None
    named = [camera for camera in scene.cameras if camera.name == name]
    if not named:
        names = [camera.name for camera in scene.cameras]
        hint = did_you_mean(name, names) or (f"; there are {', '.join(map(repr, names[:MAX_LISTED]))}" if names else "")
        raise InvalidRequest("camera", f"the file has no perspective camera {name!r}{hint}")
    return named[0]


def _view(camera: FileCamera | None, around: Extent) -> _View:
    """The view of a file's camera; the origin is the point of its line of sight that is nearest to the objects. Without
    one it is the default view, in which the objects fit the frame."""
    middle = np.array(around.centre)
    if camera is None:
        return _View(middle, around.radius * DISTANCE / FIT_RADIUS, {})
    if not 0.01 <= camera.field_of_view <= 2.8:
        raise InvalidRequest(
            "camera", f"its field of view is {camera.field_of_view:.3g}; from 0.01 to 2.8 radians are drawn"
        )
    position, forward = np.array(camera.position), np.array(camera.forward)
    distance = float(forward @ (middle - position))
    if distance <= 1e-6 * around.radius:  # the objects are beside or behind it, which `resolve` says
        distance = float(np.linalg.norm(middle - position)) or around.radius
    azimuth, elevation = atan2(-forward[0], -forward[2]), asin(max(-1.0, min(1.0, -forward[1])))
    level = camera_pose(azimuth, elevation, 1.0)
    roll = atan2(-float(level[:3, 0] @ camera.up), float(level[:3, 1] @ camera.up))
    fields: dict[str, Any] = {"azimuth": azimuth, "elevation": elevation, "field_of_view": camera.field_of_view}
    if abs(roll) > 1e-9:
        fields["roll"] = roll
    if camera.aspect is not None:
        height = Camera.model_fields["size"].default[0]
        fields["size"] = (height, max(1, min(2048, round(height * camera.aspect))))
    return _View(position + distance * forward, distance, fields)


def _scale(view: _View, extents: Sequence[Extent]) -> float:
    """The scene units in a metre: the camera has the paper's distance, unless the scene would be too large then."""
    reach = max(
        max(extent.radius / FIT_RADIUS, float(np.abs(np.array(extent.centre) - view.origin).max()))
        for extent in extents
    )
    scale = min(DISTANCE / view.distance, REACH / reach)
    if scale * view.distance < NEAREST:
        raise InvalidRequest(
            "camera",
            f"it is {view.distance:.3g} m from what it looks at, in a scene of {2 * extents[0].radius:.3g} m; a scene "
            f"may be {2 * REACH * FIT_RADIUS / NEAREST:,.0f} times as wide as its camera is far",
        )
    return scale


def _lights(
    lights: Sequence[FileLight], around: Extent, frame: _Frame
) -> tuple[dict[str, Any], float | None, list[str]]:
    """The lights of a scene, the factor from a file's intensities to energies, and what is not shown. Of each kind the
    strongest at the objects, which are `around` there, stay."""
    missing: list[str] = []
    kept: list[FileLight] = []
    for kind in ("point", "directional", "spot"):
        own = sorted((light for light in lights if light.kind == kind), key=lambda light: -_irradiance(light, around))
        shown = [light for light in own if light.intensity > DARK and _is_within_reach(light, frame)][:MAX_LIGHTS]
        kept += shown
        if dropped := [light for light in own if not any(light is other for other in shown)]:
            missing.append(
                f"{len(dropped)} of {len(own)} {kind} lights, {_named(dropped)}: they are dark, far away, or weaker at "
                f"the objects than {MAX_LIGHTS} others"
            )
    if colored := [light for light in kept if light.colored]:
        missing.append(f"the colour of the lights {_named(colored)}: lights are white here")
    total = sum(_irradiance(light, around) for light in kept)
    if not total > 0:
        missing += ["its lights: none shines where the objects are, so the default lights do"] if lights else []
        return {}, None, missing
    area = {"point": frame.scale**2, "spot": frame.scale**2, "directional": 1.0}
    exposure = min(IRRADIANCE / total, MAX_ENERGY / max(light.intensity * area[light.kind] for light in kept))
    made: dict[str, list[Any]] = {"points": [], "directional": [], "spots": []}
    for light in kept:
        energy, position = exposure * area[light.kind] * light.intensity, frame.point(light.position)
        if light.kind == "point":
            made["points"].append(PointLight(energy=energy, position=position))
        elif light.kind == "directional":
            made["directional"].append(DirectionalLight(energy=energy, direction=light.direction))
        else:
            cone = {"inner_angle": light.inner_angle, "outer_angle": light.outer_angle}
            made["spots"].append(SpotLight(energy=energy, position=position, direction=light.direction, **cone))
    return {"lights": Lights(**made, environment=Environment(map=LIGHTS))}, exposure, missing


def _is_within_reach(light: FileLight, frame: _Frame) -> bool:
    return light.kind == "directional" or max(map(abs, frame.point(light.position))) <= REACH


def _named(lights: Sequence[FileLight]) -> str:
    names = ", ".join(repr(light.name) for light in lights[:3])
    return names if len(lights) <= 3 else f"{names} and {len(lights) - 3} more"


def _irradiance(light: FileLight, around: Extent) -> float:
    """The irradiance, lux, of a surface that faces a light where the objects are; of a light among them, at the surface
    of the ball that holds them."""
    if light.kind == "directional":
        return light.intensity
    towards = np.subtract(around.centre, light.position)
    distance = float(np.linalg.norm(towards))
    at_objects = light.intensity / max(distance, around.radius) ** 2
    if light.kind == "point" or distance == 0:
        return at_objects
    low, high = cos(light.outer_angle), cos(light.inner_angle)
    along = float(towards @ np.array(light.direction)) / distance
    return at_objects * min(1.0, max(0.0, (along - low) / max(1e-3, high - low))) ** 2
