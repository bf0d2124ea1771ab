"""Reads the record of a scene back from its description after an attack has changed colours, places or the camera.

A colour is the nearest of CLEVR's eight; relations follow from the new places, as the camera now sees them. Shape, size
and material are those of the record: no attack changes an object's mesh, scale or surface.
"""

from math import cos, degrees, dist, sin

from services.scenes.clevr.attributes import RGB
from services.scenes.clevr.description import rig_of
from services.scenes.clevr.records import ObjectRecord, SceneRecord
from services.scenes.clevr.relations import relationships
from services.scenes.clevr.rig import Rig, Vector, Viewpoint
from services.scenes.description import Camera, Scene, SceneObject

CLEARLY = 2.0
"""A colour is clearly of a name if every other is at least so many times as far. At the middle between two names a
person, too, may say either."""


def record_after(record: SceneRecord, scene: Scene) -> SceneRecord:
    """Returns the record of a scene whose description was `describe(record)` and is `scene` now.

    A scene that is unchanged has the record's attributes, places and relations.
    """
    rig = rig_after(record, scene.camera)
    viewpoint = Viewpoint(rig)
    turn = scene.camera.azimuth - rig_of(record).azimuth
    along: dict[str, Vector] = {name: _turned(direction, turn) for name, direction in record.directions.items()}
    objects = tuple(_object(old, new, viewpoint) for old, new in zip(record.objects, scene.objects, strict=True))
    related = relationships([one.coords_3d for one in objects], along)
    return record.model_copy(
        update={
            "objects": objects,
            "relationships": {name: tuple(tuple(row) for row in rows) for name, rows in related.items()},
            "directions": along,
        }
    )


def rig_after(record: SceneRecord, camera: Camera) -> Rig:
    """Returns the record's lights with the camera of a description."""
    before = rig_of(record)
    level = camera.distance * cos(camera.elevation)
    place = level * sin(camera.azimuth), -level * cos(camera.azimuth), camera.distance * sin(camera.elevation)
    return Rig(place, before.key, before.fill, before.back)


def nearest_color(color: Vector) -> str:
    """Returns the name of CLEVR's colour nearest to linear reflectances in [0,1], by Euclidean distance."""
    return _by_distance(color)[0][1]


def other_readings(color: Vector) -> tuple[str, ...]:
    """Returns the other names that a colour may be read as: those less than `CLEARLY` times as far as the nearest."""
    (nearest, _), *others = _by_distance(color)
    return tuple(name for distance, name in others if distance < CLEARLY * nearest)


def _by_distance(color: Vector) -> list[tuple[float, str]]:
    """CLEVR's colours with their distances from linear reflectances in [0,1], nearest first."""
    return sorted((dist([255 * a for a in color], RGB[name]), name) for name in RGB)


def _object(old: ObjectRecord, new: SceneObject, viewpoint: Viewpoint) -> ObjectRecord:
    x, up, front = new.translation
    centre = (x, 0.0 - front, up)
    return old.model_copy(
        update={
            "color": nearest_color(new.color),
            "coords_3d": centre,
            "rotation": degrees(new.rotation[1]) % 360,
            "pixel_coords": viewpoint.pixel(centre),
        }
    )


def _turned(direction: Vector, angle: float) -> Vector:
    if angle == 0:
        return direction
    x, y, z = direction
    return x * cos(angle) - y * sin(angle), x * sin(angle) + y * cos(angle), z
