"""CLEVR's scene files: their attributes, camera, lights and relations; read and written, keeping fields not CLEVR's.

The format is that of CLEVR v1.0 (`scenes/CLEVR_val_scenes.json`) and of its generator. Scenes made here have two more
fields, `camera` and `lights`, without which a scene cannot be drawn again as it was; other programs ignore them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import atan, atan2, hypot, sqrt, tan
from pathlib import Path
from random import Random
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, FailFast, Field, ValidationError, model_validator

from scene_attack import disk
from scene_attack.errors import InvalidRequest
from scene_attack.scenes.description import Finite
from scene_attack.strict import Strict

SHAPES = ("cube", "sphere", "cylinder")
SIZES = ("small", "large")
MATERIALS = ("rubber", "metal")
RGB = {
    "gray": (87, 87, 87),
    "red": (173, 35, 35),
    "blue": (42, 75, 215),
    "green": (29, 105, 20),
    "brown": (129, 74, 25),
    "purple": (129, 38, 192),
    "cyan": (41, 208, 208),
    "yellow": (255, 238, 51),
}
"""CLEVR's colours. Divided by 255 they are linear reflectances: CLEVR hands them to Blender's shaders as such."""
COLORS = tuple(RGB)

ATTRIBUTES: dict[str, tuple[str, ...]] = {"size": SIZES, "color": COLORS, "material": MATERIALS, "shape": SHAPES}
"""The values of each attribute; the attributes have the order in which a sentence names them."""

RADIUS = {"small": 0.35, "large": 0.7}
"""Radius of the circle in the plane that an object of each size needs."""


def half_height(shape: str, size: str) -> float:
    """Returns half of an object's height: the height of its centre above the plane.

    A cube has edges of √2 · RADIUS, so that its base fits into the circle of its size.
    """
    return RADIUS[size] / sqrt(2) if shape == "cube" else RADIUS[size]


def bounding_radius(shape: str, size: str) -> float:
    """Returns the radius of an object's bounding sphere. A cylinder is as high as it is wide."""
    return RADIUS[size] * {"cube": sqrt(1.5), "sphere": 1.0, "cylinder": sqrt(2)}[shape]


Vector = tuple[float, float, float]

IMAGE_SIZE = (240, 320)
"""Height and width of CLEVR's images in pixels."""
FOCAL_LENGTH = 35 / 32
"""Focal length of the lens over the width of the sensor: 35 mm over 32 mm."""
VERTICAL_FIELD_OF_VIEW = 2 * atan(IMAGE_SIZE[0] / IMAGE_SIZE[1] / (2 * FOCAL_LENGTH))
"""Radians: 37.8°; horizontally it is 49.1°."""
CAMERA_JITTER = 0.5
"""Largest change of each coordinate of the camera's position."""
LIGHT_JITTER = 1.0
"""Largest change of each coordinate of a light's position."""


@dataclass(frozen=True)
class Rig:
    """Positions of the camera and of the three point lights. The camera looks at the origin, +z up.

    The defaults are the positions in CLEVR's base scene.
    """

    camera: Vector = (7.4811, -6.5076, 5.3437)
    key: Vector = (6.4467, -2.9052, 4.2584)
    fill: Vector = (-4.6711, -4.0136, 3.0112)
    back: Vector = (-1.1685, 2.6460, 5.8157)

    @property
    def azimuth(self) -> float:
        """Angle of the camera in the plane, from −y towards +x, radians."""
        return atan2(self.camera[0], -self.camera[1])

    @property
    def elevation(self) -> float:
        """Angle of the camera above the plane, radians."""
        return atan2(self.camera[2], hypot(self.camera[0], self.camera[1]))

    @property
    def distance(self) -> float:
        """Distance of the camera from the origin."""
        return sqrt(sum(x * x for x in self.camera))


def jittered(random: Random) -> Rig:
    """Returns a rig whose coordinates are moved uniformly within ±CAMERA_JITTER and ±LIGHT_JITTER."""
    base = Rig()

    def moved(position: Vector, most: float) -> Vector:
        x, y, z = (value + random.uniform(-most, most) for value in position)
        return x, y, z

    return Rig(
        camera=moved(base.camera, CAMERA_JITTER),
        key=moved(base.key, LIGHT_JITTER),
        fill=moved(base.fill, LIGHT_JITTER),
        back=moved(base.back, LIGHT_JITTER),
    )


class Viewpoint:
    """The camera's unit axes, for projecting points: `right`, `up`, and `behind`, along which it looks."""

    def __init__(self, rig: Rig) -> None:
        x, y, z = rig.camera
        flat, whole = hypot(x, y), rig.distance
        self._eye = rig.camera
        self.right: Vector = (-y / flat, x / flat, 0.0)
        self.behind: Vector = (-x / whole, -y / whole, -z / whole)
        self.up: Vector = (-x / flat * z / whole, -y / flat * z / whole, flat / whole)

    def in_camera(self, point: Vector) -> Vector:
        """Returns a point's distances from the eye to the right, upwards and along the viewing direction."""
        x, y, z = (a - b for a, b in zip(point, self._eye, strict=True))
        right, up, depth = (a[0] * x + a[1] * y + a[2] * z for a in (self.right, self.up, self.behind))
        return right, up, depth

    def pixel(self, point: Vector) -> tuple[int, int, float]:
        """Returns CLEVR's pixel_coords of a point: column, row, and the distance along the viewing direction."""
        right, up, depth = self.in_camera(point)
        height, width = IMAGE_SIZE
        focal = FOCAL_LENGTH * width
        return round(width / 2 + focal * right / depth), round(height / 2 - focal * up / depth), depth

    def frames(self, centre: Vector, radius: float) -> bool:
        """Returns whether a sphere is inside the frame as a whole."""
        right, up, depth = self.in_camera(centre)
        return all(
            depth * half - abs(offset) >= radius * sqrt(1 + half * half)
            for offset, half in ((right, 1 / (2 * FOCAL_LENGTH)), (up, tan(VERTICAL_FIELD_OF_VIEW / 2)))
        )


Relation = Literal["left", "right", "front", "behind"]
RELATIONS: tuple[Relation, ...] = ("left", "right", "front", "behind")
MIN_OFFSET = 0.2
"""Two objects whose centres are no further apart along a direction have no relation in it."""


def directions(rig: Rig) -> dict[str, Vector]:
    """Returns the unit vector of each relation in the plane, and CLEVR's `above` and `below`."""
    x, y, _ = rig.camera
    length = hypot(x, y)
    behind = (-x / length, -y / length)
    return {
        "right": (behind[1], -behind[0], 0.0),
        "behind": (behind[0], behind[1], 0.0),
        "above": (0.0, 0.0, 1.0),
        "below": (0.0, 0.0, -1.0),
        "left": (-behind[1], behind[0], 0.0),
        "front": (-behind[0], -behind[1], 0.0),
    }


def relationships(
    positions: Sequence[Sequence[float]], along: Mapping[str, Sequence[float]]
) -> dict[str, list[list[int]]]:
    """Returns for each relation and each object the ascending indices of the objects that have it to that object.

    `relationships(…)["left"][i]` are the objects left of object i. `positions` are the objects' centres [n][3], `along`
    has the unit vector of each relation.
    """
    related: dict[str, list[list[int]]] = {}
    for name in RELATIONS:
        offsets = [sum(a * b for a, b in zip(position, along[name], strict=True)) for position in positions]
        related[name] = [
            [j for j, there in enumerate(offsets) if j != i and there - here > MIN_OFFSET]
            for i, here in enumerate(offsets)
        ]
    return related


Triple = tuple[Finite, Finite, Finite]
Indices = Annotated[tuple[int, ...], FailFast()]
Rows = Annotated[tuple[Indices, ...], FailFast()]


class Record(Strict):
    """Base class of what is in CLEVR's files: strict, frozen; unknown fields are kept and written again."""

    model_config = ConfigDict(extra="allow", frozen=True, validate_by_name=True, validate_by_alias=True)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Reads a file. Raises InvalidRequest, which names the first invalid field ("scenes.3.objects.0.size")."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "file"
            raise InvalidRequest(where, f"{path.name}: {first['msg']}") from error

    def write(self, path: Path) -> None:
        """Writes a file: the fields that were read or set, under CLEVR's names."""
        disk.write(path, self.model_dump_json(by_alias=True, exclude_unset=True).encode())


class ObjectRecord(Record):
    """An object of a scene.

    `coords_3d` is its centre; `pixel_coords` column, row and distance along the viewing direction; `rotation` its turn
    about +z in degrees.
    """

    shape: Literal["cube", "sphere", "cylinder"]
    size: Literal["small", "large"]
    material: Literal["rubber", "metal"]
    color: Literal["gray", "red", "blue", "green", "brown", "purple", "cyan", "yellow"]
    coords_3d: Triple = Field(alias="3d_coords")
    rotation: Finite
    pixel_coords: tuple[int, int, Finite]

    def value(self, attribute: str) -> str:
        """Returns the value of one of ATTRIBUTES."""
        assert attribute in ATTRIBUTES
        value: str = getattr(self, attribute)
        return value


class CameraRecord(Record):
    """The camera of a scene made here: its position; it looks at the origin."""

    position: Triple


class LightsRecord(Record):
    """The positions of the three point lights of a scene made here."""

    key: Triple
    fill: Triple
    back: Triple


class SceneRecord(Record):
    """A scene. `relationships[r][i]` are the indices of the objects that have relation r to object i."""

    split: str
    image_index: int
    image_filename: str
    objects: Annotated[tuple[ObjectRecord, ...], FailFast()]
    relationships: dict[Relation, Rows]
    directions: dict[Literal["left", "right", "front", "behind", "above", "below"], Triple]
    camera: CameraRecord | None = None
    lights: LightsRecord | None = None

    @model_validator(mode="after")
    def _relations_are_whole(self) -> Self:
        count = len(self.objects)
        for name in RELATIONS:
            rows = self.relationships.get(name, ())
            if len(rows) != count or not all(0 <= other < count for row in rows for other in row):
                raise ValueError(
                    f"relationships.{name}: it must have a list of other objects' indices for each of {count} objects"
                )
        return self

    @property
    def rig(self) -> Rig | None:
        """Camera and lights, if the record has them; official files do not."""
        if self.camera is None or self.lights is None:
            return None
        return Rig(self.camera.position, self.lights.key, self.lights.fill, self.lights.back)


class Info(Record):
    """The header of CLEVR's files."""

    split: str
    version: str = "1.0"
    date: str = ""
    license: str = ""


class SceneFile(Record):
    """A file of scenes."""

    info: Info
    scenes: tuple[SceneRecord, ...]
