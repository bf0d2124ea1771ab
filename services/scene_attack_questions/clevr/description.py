"""A CLEVR scene as the renderers see it: from a record or request to `scene_attack.scenes.description.Scene`, and back.

CLEVR's world has +z up, ours has +y up: a point (x, y, z) there is (x, z, −y) here, in the same units.

`record_after` reads a record back after an attack has changed colours, places or the camera. A colour is the nearest
of CLEVR's eight; relations follow from the new places, as the camera now sees them. Shape, size and material are those
of the record: no attack changes an object's mesh, scale or surface.
"""

from math import atan2, cos, degrees, dist, hypot, pi, radians, remainder, sin

from pydantic import ValidationError

from scene_attack.errors import InvalidRequest, below
from scene_attack.scenes.description import Camera, Environment, Floor, Lights, PointLight, Scene, SceneObject, Shadows
from scene_attack.scenes.mesh import FIT_RADIUS
from scene_attack_questions.clevr.generator import MAX_OBJECTS, check
from scene_attack_questions.clevr.records import (
    IMAGE_SIZE,
    RELATIONS,
    RGB,
    VERTICAL_FIELD_OF_VIEW,
    ObjectRecord,
    Rig,
    SceneRecord,
    Vector,
    Viewpoint,
    bounding_radius,
    directions,
    relationships,
)

ENERGY = {"key": 100.0, "fill": 30.0, "back": 50.0}
"""Radiant intensities. Together with AMBIENT they keep the plane and matte objects below white."""
AMBIENT = 0.4
"""Mean radiance from all around; without it metals, which reflect no surroundings here, would be nearly black."""
FLOOR_COLOR = (0.6, 0.6, 0.6)
FLOOR_SIZE = 100.0
"""Side of the floor: its edge is beyond the highest row of the image for every camera within the jitter."""
SHADOW_SOFTNESS = 0.25
"""Radius of the lights: CLEVR's lamps are squares with sides of 0.5, the back one of 1."""
MAP_SIZE = (16, 32)
"""Rows and columns of the torch renderer's light: as fine as the spots that stand for the lamps are wide."""
METALLIC = {"rubber": 0.0, "metal": 1.0}
ROUGHNESS = {"rubber": 0.7, "metal": 0.4}


def describe(record: SceneRecord, size: tuple[int, int] = IMAGE_SIZE) -> Scene:
    """Returns the description of a scene. `size` is the height and width of its image in pixels.

    A record without camera and lights, as official files have, gets those of CLEVR's base scene, turned about +z to the
    direction in which its camera looked; its height and distance are not in the file.
    """
    rig = rig_of(record)
    return Scene(
        camera=Camera(
            azimuth=rig.azimuth,
            elevation=rig.elevation,
            distance=rig.distance,
            field_of_view=VERTICAL_FIELD_OF_VIEW,
            size=size,
            viewer="perspective",
        ),
        objects=tuple(_object(thing) for thing in record.objects),
        lights=Lights(
            ambient=AMBIENT,
            points=tuple(
                PointLight(energy=energy, position=_ours(getattr(rig, name))) for name, energy in ENERGY.items()
            ),
            environment=Environment(map="lights", size=MAP_SIZE),
        ),
        ground=FLOOR_COLOR,
        floor=Floor(size=FLOOR_SIZE, height=0.0, color=FLOOR_COLOR, material="matte", metallic=0.0, roughness=1.0),
        shadows=Shadows(softness=SHADOW_SOFTNESS),
    )


def rig_of(record: SceneRecord) -> Rig:
    """Returns a record's camera and lights; see `describe` for a record that has none."""
    if record.rig is not None:
        return record.rig
    base = Rig()
    x, y, _ = record.directions["behind"]
    turn = atan2(-x, y) - base.azimuth
    camera, key, fill, back = (_turned(point, turn) for point in (base.camera, base.key, base.fill, base.back))
    return Rig(camera, key, fill, back)


def _object(thing: ObjectRecord) -> SceneObject:
    red, green, blue = RGB[thing.color]
    return SceneObject(
        mesh=f"primitive/{thing.shape}",
        material=thing.material,
        metallic=METALLIC[thing.material],
        roughness=ROUGHNESS[thing.material],
        color=(red / 255, green / 255, blue / 255),
        translation=_ours(thing.coords_3d),
        rotation=(0.0, remainder(radians(thing.rotation), 2 * pi), 0.0),
        scale=bounding_radius(thing.shape, thing.size) / FIT_RADIUS,
    )


def _ours(point: Vector) -> Vector:
    return point[0], point[2], 0.0 - point[1]


def _turned(point: Vector, angle: float) -> Vector:
    x, y, z = point
    return x * cos(angle) - y * sin(angle), x * sin(angle) + y * cos(angle), z


CLEARLY = 2.0
"""Least ratio of the distances to any other named colour and to the nearest at which a colour clearly has that name.
At the middle between two names a person, too, may say either."""


def record_after(record: SceneRecord, scene: Scene) -> SceneRecord:
    """Returns the record of a scene whose description was `describe(record)` and is `scene` now.

    A scene that is unchanged has the record's attributes, places and relations.
    """
    rig = rig_after(record, scene.camera)
    viewpoint = Viewpoint(rig)
    turn = scene.camera.azimuth - rig_of(record).azimuth
    along: dict[str, Vector] = {name: _turned(direction, turn) for name, direction in record.directions.items()}
    objects = tuple(_read_object(old, new, viewpoint) for old, new in zip(record.objects, scene.objects, strict=True))
    related = relationships([thing.coords_3d for thing in objects], along)
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


def _read_object(old: ObjectRecord, new: SceneObject, viewpoint: Viewpoint) -> ObjectRecord:
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


LEAST_ASIDE = 1e-6
"""Least distance of a camera from the vertical through the origin: from there nothing is left or right."""
DIRECTION = 1e-3
"""Largest difference of a component of a stated direction from the camera's. Official files are off by up to 1e-4."""
_FIELDS = {"Camera": "camera.position", "PointLight": "lights", "SceneObject": "objects"}
"""The parts of a description, and the fields of a record that they follow from."""


def scene_of(record: SceneRecord) -> Scene:
    """Returns the description of a scene that a request gives as a record.

    Raises InvalidRequest, which names the field, for objects that float, overlap or leave the frame
    ("record.objects.2"), for directions that are not those of the camera ("record.directions.left"), for relations that
    are not those of the objects' places ("record.relationships.left.0"), and for a camera or lights that a scene cannot
    have ("record.camera.position") or that are given without the other ("record.lights").
    """
    if not 0 < len(record.objects) <= MAX_OBJECTS:
        raise InvalidRequest("record.objects", f"there are {len(record.objects)}; a scene has 1 to {MAX_OBJECTS}")
    if missing := [name for name in RELATIONS if name not in record.directions]:
        raise InvalidRequest("record.directions", f"it has no direction of {missing[0]}")
    for present, absent in (("camera", "lights"), ("lights", "camera")):
        if getattr(record, present) is not None and getattr(record, absent) is None:
            raise InvalidRequest(f"record.{absent}", f"is required where `{present}` is given; or leave out both")
    rig = rig_of(record)
    if hypot(*rig.camera[:2]) < LEAST_ASIDE:
        raise InvalidRequest("record.camera.position", "it is straight above or below the origin, which it looks at")
    with below("record"):
        check(record.objects, rig)
    try:
        scene = describe(record)
    except ValidationError as error:
        raise InvalidRequest(f"record.{_FIELDS[error.title]}", error.errors()[0]["msg"]) from error
    _check_directions(record, rig)
    due = relationships([thing.coords_3d for thing in record.objects], dict(record.directions.items()))
    for name in RELATIONS:
        for k, (stated, true) in enumerate(zip(record.relationships[name], due[name], strict=True)):
            if sorted(stated) != true:
                stated_words = f"{sorted(stated)}" if len(stated) <= MAX_OBJECTS else f"{len(stated)} objects"
                raise InvalidRequest(
                    f"record.relationships.{name}.{k}",
                    f"it has {stated_words}; by their places the objects {name} of object {k} are {true}",
                )
    return scene


def _check_directions(record: SceneRecord, rig: Rig) -> None:
    """Refuses directions that the image does not show: the truth about left and right would be another's."""
    due = directions(rig)
    for name in RELATIONS:
        stated = record.directions[name]
        if any(abs(a - b) > DIRECTION for a, b in zip(stated, due[name], strict=True)):
            by = "the camera's place" if record.camera is not None else "the direction of `behind`"
            stated_vector, true_vector = ([round(x, 4) for x in vector] for vector in (stated, due[name]))
            raise InvalidRequest(f"record.directions.{name}", f"it is {stated_vector}; by {by} it is {true_vector}")
