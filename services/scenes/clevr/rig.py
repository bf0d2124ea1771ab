"""The camera and the three lights of a CLEVR scene, with their jitter."""

from dataclasses import dataclass
from math import atan, atan2, cos, hypot, sin, sqrt, tan
from random import Random

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

    The defaults are the positions in CLEVR's base scene. `roll` turns the camera about its viewing direction to its
    own left, radians.
    """

    camera: Vector = (7.4811, -6.5076, 5.3437)
    key: Vector = (6.4467, -2.9052, 4.2584)
    fill: Vector = (-4.6711, -4.0136, 3.0112)
    back: Vector = (-1.1685, 2.6460, 5.8157)
    roll: float = 0.0

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
        if rig.roll:
            self.right, self.up = _rolled(self.right, self.up, rig.roll)

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


def _rolled(right: Vector, up: Vector, roll: float) -> tuple[Vector, Vector]:
    """Returns a camera's axes after a roll, as `services.scenes.view.camera_pose` turns them."""
    (a, b, c), (d, e, f) = right, up
    along, across = cos(roll), sin(roll)
    return (
        (along * a + across * d, along * b + across * e, along * c + across * f),
        (along * d - across * a, along * e - across * b, along * f - across * c),
    )
