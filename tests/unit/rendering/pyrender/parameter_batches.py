"""Batches of the pyrender renderer's parameters."""

import torch

from scene_attack.rendering.pyrender.renderer import PyrenderRenderer


def batch_of_one(renderer: PyrenderRenderer, **changes: torch.Tensor) -> dict[str, torch.Tensor]:
    """The scene's own parameters {group: [1, ...]}, where `changes` replace some groups."""
    return {group: changes.get(group, value)[None] for group, value in renderer.initial().items()}
