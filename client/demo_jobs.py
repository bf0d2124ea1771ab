"""The jobs of the demonstration: three things the network knows, each attacked in three spaces."""

from typing import Any

SCENES: dict[str, dict[str, Any]] = {
    "soccer ball": {"objects": [{"mesh": "furniture/soccer-ball"}]},
    "grand piano": {"objects": [{"mesh": "furniture/grand-piano", "material": "glossy-paint"}]},
    "power drill": {"objects": [{"mesh": "furniture/drill", "material": "plastic"}]},
}
"""The true label, which the network must say to begin with, and the scene.

Two of which the network is sure (log-probability margins of 4.7 and more in pyrender's image) and one of which it is
less so (2.5): light, colour and pose rarely fool a sure network, and a demonstration should show both.
"""

ATTACKS: tuple[dict[str, Any], ...] = (
    {"renderer": "image", "method": "fgsm"},
    {"renderer": "torch", "groups": ["normals", "illumination", "material"], "method": "fgsm"},
    {"renderer": "pyrender", "method": "zoo", "steps": 60, "weight": 1e-3, "learning_rate": 5e-3},
)
"""FGSM with the paper's settings. ZOO with a λ a hundred times smaller than the paper's, so that changes may be seen:
with the paper's 0.1 no physical attack in any trial of ours fooled the network."""


def specs() -> list[dict[str, Any]]:
    """One request per scene and attack."""
    return [
        {"scene": scene, "goal": {"leave": label}, "attack": attack}
        for label, scene in SCENES.items()
        for attack in ATTACKS
    ]
