"""Real jobs, small enough to run many."""

from typing import Any


def scene(size: int = 64) -> dict[str, Any]:
    return {"camera": {"size": [size, size]}, "objects": [{"mesh": "primitive/sphere"}]}


QUICK: dict[str, Any] = {
    "scene": scene(),
    "attack": {"renderer": "image", "base_renderer": "pyrender", "steps": 3},
}
"""Ends by itself at once."""

GROUPS: dict[str, Any] = {
    "scene": scene(),
    "attack": {"renderer": "torch", "groups": ["normals", "illumination", "material"], "steps": 2},
}
"""Ends by itself in seconds, and changes the scene in three ways."""


def long(steps: int) -> dict[str, Any]:
    """Takes all its steps: towards a label it cannot reach with steps so small. Its perturbation is not zero."""
    attack = {"renderer": "image", "base_renderer": "pyrender", "steps": steps, "learning_rate": {"image": 1e-6}}
    return {"scene": scene(), "goal": {"reach": "tench"}, "attack": attack}


LASTING = long(150)
"""A few seconds of steps: time for a checkpoint, and to be killed in the middle."""
ENDLESS = long(10_000)
"""Minutes of steps: a test stops it."""
