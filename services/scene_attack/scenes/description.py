"""Defines the scene of a request: camera, objects, lights and ground; and names its objects in sentences and tables.

Angles are in radians, lengths in scene units (an object of scale 1 fits the frame at the paper's distance of 1.8),
colours in [0,1]; +y is up. Every field but the mesh has a default, and bounds that are checked before a job is queued.
"""

import operator
from collections import Counter
from collections.abc import Mapping
from math import pi
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from scene_attack.errors import below
from scene_attack.scenes.mesh_arrays import MeshArrays
from scene_attack.scenes.source import AnySource
from scene_attack.strict import Model, Several, absent, reference

Finite = Annotated[float, Field(allow_inf_nan=False)]
Unit = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-100, le=100, allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=-2 * pi, le=2 * pi, allow_inf_nan=False)]
Vector = tuple[Coordinate, Coordinate, Coordinate]
Rotation = tuple[Angle, Angle, Angle]
Colour = tuple[Unit, Unit, Unit]
Pixels = Annotated[int, Field(ge=1, le=2048)]

ELEVATION = 0.3490658503988659
"""The paper's fixed elevation, π/9 radians."""
DISTANCE = 1.8
"""The paper's fixed camera distance, scene units."""
FIELD_OF_VIEW = 0.8575
"""Vertical field of view, radians (49.1°): that of Blender's default lens, which the paper's views have."""
GROUND = 128 / 255
"""Default displayed value of the ground's channels."""
MAP_SIZES = ((4, 8), (8, 16), (16, 32), (32, 64), (64, 128))
"""Sizes of environment maps that "auto" chooses from, the smallest first; the last is the largest there is."""
MAX_LIGHTS = 4
"""Maximum number of lights of each kind; pyrender's limit."""
MIN_LENGTH = 1e-3
"""Lower bound of a direction's largest absolute coordinate, below which rounding would change the direction."""


MAX_PICTURE = 400_000
"""Largest number of characters of a picture in base64: a file of 300 kB."""
METALLIC = "0: plastic, 1: metal (pyrender, by glTF's metallic-roughness BRDF)"
ROUGHNESS = "0: smooth, 1: rough (pyrender, by the same BRDF); below 0.04 it is drawn as 0.04"


class Camera(Model):
    """A camera on a sphere around the origin, looking at it, +y up unless it is rolled."""

    azimuth: Angle = Field(default=0.61, description="angle about +y from +z towards +x, radians")
    elevation: Annotated[float, Field(ge=-pi / 2, le=pi / 2, allow_inf_nan=False)] = Field(
        default=ELEVATION, description="angle above the horizon, radians; the paper's is π/9"
    )
    distance: Annotated[float, Field(ge=0.05, le=100, allow_inf_nan=False)] = Field(
        default=DISTANCE, description="distance from the origin, scene units; the paper's is 1.8"
    )
    roll: Angle = Field(
        default=0.0,
        exclude_if=operator.not_,
        description="turn about its line of sight to its own left, radians: its image turns clockwise",
    )
    field_of_view: Annotated[float, Field(ge=0.01, le=2.8, allow_inf_nan=False)] = Field(
        default=FIELD_OF_VIEW, description="vertical field of view, radians"
    )
    far: Annotated[float, Field(ge=0.1, le=1e5, allow_inf_nan=False)] | None = Field(
        default=None,
        exclude_if=absent,
        description="distance beyond which nothing is drawn, scene units; null: behind all that is in the scene",
    )
    size: tuple[Pixels, Pixels] = Field(
        default=(224, 224), description="height and width in pixels; the paper's is 448×448"
    )
    viewer: Literal["distant", "perspective"] = Field(
        default="distant",
        description="viewer direction of highlights (torch): the same for all pixels, as in the paper, or each pixel's "
        "own; at distance 3 the two differ by up to a third of a highlight",
    )


def _as_written(mesh: object, handler: ValidatorFunctionWrapHandler) -> Any:
    """A path as a request writes it: one that is relative to a folder begins with "./". Arrays stay with their name."""
    if isinstance(mesh, PurePath):
        mesh = str(mesh) if mesh.is_absolute() else f"./{mesh}"
    name = handler(mesh)
    return mesh if isinstance(mesh, MeshArrays) else name


MeshName = Annotated[str, Field(min_length=1, max_length=200), reference("mesh"), WrapValidator(_as_written)]

if TYPE_CHECKING:
    from scene_attack.strict import Converted

    GivenMesh = Converted[str, str | PurePath | MeshArrays]
else:
    GivenMesh = MeshName


class SceneObject(Model):
    """A mesh in the scene, with its surface and its pose."""

    mesh: GivenMesh = Field(
        description="`furniture/<slug>`, `primitive/<name>`, or the id of an uploaded mesh (`sha256:<hex>`; "
        "`sha256:<hex>#12` is a node of a scene's file, `sha256:<hex>#!12,15` all but some nodes)",
    )
    material: Annotated[str, reference("material")] = Field(
        default="matte", max_length=64, description="kind of surface, which says how it reflects light (torch)"
    )
    color: Colour = Field(default=(1.0, 1.0, 1.0), description="linear RGB factor on the mesh's own colours")
    translation: Vector = Field(default=(0.0, 0.0, 0.0), description="position of the object's centre, scene units")
    rotation: Rotation = Field(default=(0.0, 0.0, 0.0), description="rotation vector (axis times angle), radians")
    scale: Annotated[float, Field(ge=1e-3, le=100, allow_inf_nan=False)] = Field(
        default=1.0, description="size; at 1 the object's bounding sphere fits the frame at distance 1.8"
    )
    metallic: Unit | None = Field(
        default=None,
        exclude_if=absent,
        description=f"{METALLIC}; null: the mesh's own surface, or 0 if `roughness` is given",
    )
    roughness: Unit | None = Field(
        default=None,
        exclude_if=absent,
        description=f"{ROUGHNESS}; null: the mesh's own surface, or 0.5 if `metallic` is given",
    )


class Floor(Model):
    """A level square under the objects. It is no object: attacks neither move nor recolour it."""

    size: Annotated[float, Field(ge=0.01, le=200, allow_inf_nan=False)] = Field(
        default=20.0, description="side, scene units; its middle is straight above or below the origin"
    )
    height: Coordinate = Field(default=0.0, description="y of its plane, scene units")
    contact: bool = Field(
        default=False,
        exclude_if=operator.not_,
        description="whether `height` is above the lowest point of all objects, to which each one is lowered: at 0 all "
        "stand on the floor",
    )
    color: Colour = Field(default=(0.5, 0.5, 0.5), description="linear RGB")
    material: Annotated[str, reference("material")] = Field(
        default="matte", max_length=64, description="kind of surface, which says how it reflects light (torch)"
    )
    metallic: Unit | None = Field(
        default=None,
        exclude_if=absent,
        description=f"{METALLIC}; null: a Lambertian body under a coat, or 0 if `roughness` is given",
    )
    roughness: Unit | None = Field(
        default=None,
        exclude_if=absent,
        description=f"{ROUGHNESS}; null: a Lambertian body under a coat, or 0.5 if `metallic` is given",
    )


def _direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if max(map(abs, value)) < MIN_LENGTH:
        raise ValueError(f"is too short for a direction; one of its coordinates must be {MIN_LENGTH:g} or more in size")
    return value


Direction = Annotated[Vector, AfterValidator(_direction)]


class PointLight(Model):
    """A point light of the pyrender renderer; its light falls off with the square of the distance."""

    energy: Annotated[float, Field(ge=0, le=10_000, allow_inf_nan=False)] = Field(
        default=30.0, description="radiant intensity; 30 at distance 3 lights a white surface facing it about fully"
    )
    position: Vector = Field(default=(1.2, 2.0, 1.5), description="scene units")


class DirectionalLight(Model):
    """A light of the pyrender renderer at infinite distance, with parallel rays, like the sun."""

    energy: Annotated[float, Field(ge=0, le=10_000, allow_inf_nan=False)] = Field(
        default=3.0, description="irradiance of a surface that faces it; 3 is about that of the default point light"
    )
    direction: Direction = Field(
        default=(-1.2, -2.0, -1.5),
        description="direction in which its light travels; any length above 0, which has no effect",
    )


class SpotLight(Model):
    """A point light of the pyrender renderer that shines into a cone only."""

    energy: Annotated[float, Field(ge=0, le=10_000, allow_inf_nan=False)] = Field(
        default=30.0,
        description="radiant intensity within the inner angle; it falls off with the square of the distance",
    )
    position: Vector = Field(default=(1.2, 2.0, 1.5), description="scene units")
    direction: Direction = Field(
        default=(-1.2, -2.0, -1.5), description="axis of its cone, pointing away from the light; any length above 0"
    )
    inner_angle: Annotated[float, Field(ge=0, le=pi / 2, allow_inf_nan=False)] = Field(
        default=0.0,
        description="angle from the axis where the light begins to fall off, radians; 0 to below `outer_angle`",
    )
    outer_angle: Annotated[float, Field(gt=0, le=pi / 2, allow_inf_nan=False)] = Field(
        default=pi / 4,
        description="angle from the axis where the light has fallen to 0, radians; at most π/2",
        validate_default=True,  # against an inner angle that was given
    )

    @field_validator("outer_angle")
    @classmethod
    def _is_outside(cls, value: float, info: ValidationInfo) -> float:
        inner = info.data.get("inner_angle", 0.0)
        if value <= inner:
            raise ValueError(f"it must be above inner_angle, which is {inner:g}")
        return value


class Environment(Model):
    """A high-dynamic-range environment map: the light of the torch renderer."""

    map: Annotated[str, reference("map")] = Field(
        default="studio",
        min_length=1,
        max_length=200,
        description="name of a built-in map, or the id of an uploaded one (`sha256:<hex>`); `lights`: the scene's own "
        "lights as the origin sees them",
    )
    size: tuple[Annotated[int, Field(ge=1, le=64)], Annotated[int, Field(ge=1, le=128)]] | Literal["auto"] = Field(
        default=(16, 32),
        description="rows (polar angle) and columns (azimuth) it is averaged down to; `auto`: the smallest of 4×8, "
        "8×16, 16×32, 32×64 and 64×128 whose error against 64×128 is within the job's tolerance",
    )
    rotation: Angle = Field(default=0.0, description="turn about +y, radians")

    @property
    def texels(self) -> tuple[int, int]:
        """Rows and columns of the map; the largest size while "auto" is undecided."""
        return MAP_SIZES[-1] if self.size == "auto" else self.size


class Lights(Model):
    """All lights of a scene. The torch renderer uses the environment map, pyrender the others."""

    ambient: Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)] = Field(
        default=0.4, description="mean radiance of the light from all around, brighter above (pyrender)"
    )
    points: Several[PointLight] = Field(
        default=(PointLight(),),  # type: ignore[arg-type]
        max_length=MAX_LIGHTS,
        description=f"point lights, at most {MAX_LIGHTS} (pyrender)",
    )
    directional: Several[DirectionalLight] = Field(
        default=(),  # type: ignore[arg-type]
        max_length=MAX_LIGHTS,
        description=f"directional lights, at most {MAX_LIGHTS} (pyrender)",
    )
    spots: Several[SpotLight] = Field(
        default=(),  # type: ignore[arg-type]
        max_length=MAX_LIGHTS,
        description=f"spot lights, at most {MAX_LIGHTS} (pyrender)",
    )
    environment: Environment = Environment()


class Shadows(Model):
    """Shadows that objects cast on each other and on themselves."""

    softness: Annotated[float, Field(ge=0, le=10, allow_inf_nan=False)] = Field(
        default=0.1, description="radius of each point and spot light as seen by what it shades, scene units (pyrender)"
    )
    angle: Annotated[float, Field(ge=0, le=0.5, allow_inf_nan=False)] = Field(
        default=0.02, description="angular radius of each directional light, radians; the sun's is 0.005 (pyrender)"
    )
    resolution: Annotated[int, Field(ge=64, le=4096, multiple_of=8)] = Field(
        default=1024, description="texels a side of each shadow map, a multiple of 8 (pyrender)"
    )
    samples: Annotated[int, Field(ge=1, le=64)] = Field(
        default=16, description="points of each light whose shadows are averaged (pyrender)"
    )
    texel_samples: Annotated[int, Field(ge=1, le=8)] = Field(
        default=2,
        description="directions a side of each texel of the environment map, a square grid of them, whose shadows are "
        "averaged (torch)",
    )


class Background(Model):
    """What is behind objects and floor, in place of the colour `ground`: the environment map, or a picture."""

    image: Annotated[str, Field(min_length=1, max_length=MAX_PICTURE)] | None = Field(
        default=None,
        exclude_if=absent,
        description="a PNG, JPEG or WebP file in base64, of the size of the camera's image; null: the environment map "
        "as the camera sees it, in the exposure of the torch renderer",
    )


class _Sourced(Model):
    source: AnySource


def _objects_may_follow(schema: dict[str, Any]) -> None:
    del schema["required"]  # it is the only field without a default


def _completed(follows: Any, stated: Any) -> Any:
    """A part of a scene of which a request may state some fields, such as the camera's size; the rest follows."""
    if isinstance(follows, Model) and isinstance(stated, dict):
        return {name: getattr(follows, name) for name in follows.model_fields_set} | stated
    return stated


class Scene(Model):
    """A complete scene. Only `objects` has no default; with a `source`, what is left out follows from it."""

    model_config = ConfigDict(json_schema_extra=_objects_may_follow)

    source: AnySource | None = Field(
        default=None,
        exclude_if=absent,
        description="the scene as another program describes it, from which the other fields follow",
    )
    camera: Camera = Camera()
    objects: Several[SceneObject] = Field(min_length=1, max_length=16)
    fixed: Several[SceneObject] = Field(
        default=(),  # type: ignore[arg-type]
        max_length=16,
        exclude_if=operator.not_,
        description="what else is in the scene, such as the room: drawn and casting shadows, and changed by no attack",
    )
    floor: Floor | None = Field(
        default=None, exclude_if=absent, description="a floor for the objects to stand on; null: none"
    )
    lights: Lights = Lights()
    shadows: Shadows | None = Field(
        default=None, exclude_if=absent, description="shadows of the objects; null: none are drawn"
    )
    ground: Colour = Field(
        default=(GROUND, GROUND, GROUND),
        description="displayed colour behind the objects; rounded to k/255, so that 8-bit images keep it exactly",
    )
    background: Background | None = Field(
        default=None,
        exclude_if=absent,
        description="a picture or the environment map in place of `ground`; null: neither",
    )

    @model_validator(mode="before")
    @classmethod
    def _from_its_source(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or data.get("source") is None:
            return data
        # its errors are those of the field
        source = _Sourced.model_validate({"source": data["source"]}, context=info.context).source
        with below("source"):
            source = source.filled_in()
            follows = {} if "objects" in data else source.follows()
        stated = {name: _completed(follows.get(name), part) for name, part in data.items()}
        return {**follows, **stated, "source": source}

    @field_validator("ground")
    @classmethod
    def _eight_bits(cls, value: tuple[float, float, float]) -> Any:
        return tuple(round(v * 255) / 255 for v in value)


def object_names(scene: Scene, titles: Mapping[str, str]) -> list[str]:
    """A name for each object: its mesh's without the folder, or what people call it by `titles`; its number if the mesh
    has none or others share it.
    """
    names = [titles.get(thing.mesh, thing.mesh.rpartition("/")[2]) for thing in scene.objects]
    shared = Counter(names)
    plain = [not name.startswith("sha256:") and shared[name] == 1 for name in names]
    return [name if good else f"object {k}" for k, (name, good) in enumerate(zip(names, plain, strict=True))]
