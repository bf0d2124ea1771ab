"""The jobs of the demonstration: three things the network knows, each attacked in three spaces."""

from typing import Any

SCENES: dict[str, dict[str, Any]] = {
    "soccer ball": {"objects": [{"mesh": "furniture/soccer-ball"}]},
    "toilet seat": {"objects": [{"mesh": "furniture/toilets-unit"}]},
    "grand piano": {"objects": [{"mesh": "furniture/grand-piano", "material": "glossy-paint"}]},
}
"""The true label, which the network must say to begin with, and the scene."""

ATTACKS: tuple[dict[str, Any], ...] = (
    {"renderer": "image", "method": "fgsm"},
    {"renderer": "torch", "groups": ["normals", "illumination", "material"], "method": "fgsm"},
    {"renderer": "pyrender", "method": "zoo", "steps": 40},
)


def specs() -> list[dict[str, Any]]:
    """One request per scene and attack."""
    return [
        {"scene": scene, "goal": {"leave": label}, "attack": attack}
        for label, scene in SCENES.items()
        for attack in ATTACKS
    ]
