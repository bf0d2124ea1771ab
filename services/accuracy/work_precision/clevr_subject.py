"""A CLEVR-style scene that the report measures, with a floor, metal and shadows."""

from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import generate
from services.scenes.description import Scene

OBJECTS = 5
SCENE = f"CLEVR, {OBJECTS} objects"


def described(size: tuple[int, int]) -> Scene:
    """The scene's description, the same every time. `size`: height and width of its image in pixels."""
    return describe(generate(0, 0, objects=(OBJECTS, OBJECTS)), size)
