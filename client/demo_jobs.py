"""The jobs of the demonstration: three objects that the network recognises, each attacked by three renderers, and a
question about an image.
"""

from typing import Any

SCENES: dict[str, dict[str, Any]] = {
    "soccer ball": {"objects": [{"mesh": "furniture/soccer-ball"}]},
    "grand piano": {"objects": [{"mesh": "furniture/grand-piano", "material": "glossy-paint"}]},
    "power drill": {"objects": [{"mesh": "furniture/drill", "material": "plastic"}]},
}
"""The scenes by their true label, which is the network's answer to the original image.

The network is confident of two (log-probability margins of at least 4.7 in pyrender's image) and less so of the third
(2.5). Light, colour and pose rarely fool a confident network, and the demonstration should show both outcomes.
"""

ATTACKS: tuple[dict[str, Any], ...] = (
    {"renderer": "image", "method": "fgsm"},
    {"renderer": "torch", "groups": ["normals", "illumination", "material"], "method": "fgsm"},
    {"renderer": "pyrender", "method": "zoo", "steps": 60, "weight": 1e-3, "learning_rate": 5e-3},
)
"""FGSM has the paper's settings. ZOO has a λ a hundred times smaller than the paper's 0.1, with which no physical
attack fooled the network in our trials."""

QUESTION: dict[str, Any] = {
    "generate": {"seed": 8, "objects": 4},
    "target": {"name": "iep", "question": "What is the color of the object that is left of the cyan thing?"},
    "attack": {"renderer": "torch", "groups": ["normals", "illumination"], "method": "fgsm", "steps": 40},
}
"""The request of `examples/vqa-torch.json`."""


def specs() -> list[dict[str, Any]]:
    """One request per scene and attack, and that of the question."""
    furniture = [
        {"scene": scene, "goal": {"leave": label}, "attack": attack}
        for label, scene in SCENES.items()
        for attack in ATTACKS
    ]
    return [*furniture, QUESTION]
