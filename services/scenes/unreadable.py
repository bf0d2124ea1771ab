"""The errors of files that cannot be read, and of those that are too large."""

DAMAGED = "it is damaged, or cut off"
"""Message where a third-party parser stops, whose own message is about itself and not about the file."""


SIMPLIFY = (
    "simplify it, by Blender's modifier Decimate or by trimesh's simplify_quadric_decimation, or raise the service's "
    "setting SCENE_ATTACK_MAX_FACES"
)
"""Advice about a mesh of too many triangles."""


class Unreadable(ValueError):
    """A file, or a part of it, is not what it should be; the message says why, in words for whoever made the file."""


class TooLarge(ValueError):
    """A file can be read, but has more triangles or vertices than are taken.

    count: how many of `what` it has; most: how many may be; vertices are limited to three for each triangle.
    """

    def __init__(self, count: int, what: str, most: int) -> None:
        super().__init__(f"it declares {count:,} {what}, and at most {most:,} are taken; {SIMPLIFY}")
