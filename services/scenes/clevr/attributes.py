"""The attributes of a CLEVR object, their values, and the solids that shape and size stand for."""

from math import sqrt

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
