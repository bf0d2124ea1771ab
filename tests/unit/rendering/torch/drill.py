"""The result of an attack on one group of a drill, by a small network with random weights."""

from typing import Any

import torch

import scene_attack as sa


def attacked(group: str, steps: int = 20, **attack: Any) -> sa.Result:
    """By FGSM through the torch renderer."""
    torch.manual_seed(0)
    layers = [torch.nn.Conv2d(3, 16, 5, 4), torch.nn.ReLU(), torch.nn.AdaptiveAvgPool2d(2), torch.nn.Flatten()]
    model = torch.nn.Sequential(*layers, torch.nn.Linear(64, 5))
    target = sa.target(model, labels=list("abcde"), preprocessing=sa.Preprocessing(input_size=(32, 32)))
    scene = sa.Scene(
        camera=sa.Camera(size=(64, 64)), objects=[sa.Object(mesh="furniture/drill", material="plastic", scale=0.8)]
    )
    return sa.attack(scene, target, sa.FGSM(renderer="torch", groups=[group], steps=steps, **attack), seed=3)
