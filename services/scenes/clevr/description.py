"""Describes a CLEVR scene for the renderers: from its record to `services.scenes.description.Scene`.

CLEVR's world has +z up, ours has +y up: a point (x, y, z) there is (x, z, −y) here, in the same units.
"""

from math import atan2, cos, pi, radians, remainder, sin

from services.scenes.clevr.attributes import RGB, bounding_radius
from services.scenes.clevr.records import ObjectRecord, SceneRecord
from services.scenes.clevr.rig import IMAGE_SIZE, VERTICAL_FIELD_OF_VIEW, Rig, Vector
from services.scenes.description import Camera, Environment, Floor, Lights, PointLight, Scene, SceneObject, Shadows
from services.scenes.mesh import FIT_RADIUS

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
        objects=tuple(_object(one) for one in record.objects),
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


def _object(one: ObjectRecord) -> SceneObject:
    red, green, blue = RGB[one.color]
    return SceneObject(
        mesh=f"primitive/{one.shape}",
        material=one.material,
        metallic=METALLIC[one.material],
        roughness=ROUGHNESS[one.material],
        color=(red / 255, green / 255, blue / 255),
        translation=_ours(one.coords_3d),
        rotation=(0.0, remainder(radians(one.rotation), 2 * pi), 0.0),
        scale=bounding_radius(one.shape, one.size) / FIT_RADIUS,
    )


def _ours(point: Vector) -> Vector:
    return point[0], point[2], 0.0 - point[1]


def _turned(point: Vector, angle: float) -> Vector:
    x, y, z = point
    return x * cos(angle) - y * sin(angle), x * sin(angle) + y * cos(angle), z
