"""Objects of the cases: a few triangles whose every corner is known; and a linear network on a few pixels with the
problem of attacking it.
"""

from math import isfinite
from typing import Any

import numpy as np
import torch
import trimesh
from torch import Tensor, nn

from scene_attack.attacks.attack import Attack
from scene_attack.attacks.goal import ResolvedGoal
from scene_attack.attacks.limits import Limits
from scene_attack.attacks.problem import AttackProblem
from scene_attack.attacks.run import AttackRun, Verifier, run_attack
from scene_attack.rendering.image import ImageRenderer
from scene_attack.rendering.protocol import Renderer
from scene_attack.scenes.mesh import Bytes, Doubles, Part
from scene_attack.targets.classifier import Classifier
from scene_attack_accuracy.stability.case import need


def square_arrays(**more: Any) -> dict[str, Doubles]:
    """A square of side 2 in z = 0 that faces +z, u to the right and v down from its upper left corner; with or instead
    of these, `more` arrays."""
    return {
        "POSITION": np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float64),
        "NORMAL": np.tile([0.0, 0.0, 1.0], (4, 1)),
        "TEXCOORD_0": np.array([(0, 1), (1, 1), (1, 0), (0, 0)], np.float64),
        "indices": np.array([0, 1, 2, 0, 2, 3]),
    } | {name: np.array(values) for name, values in more.items()}


SIDES = np.array([(0, 1, 2), (0, 2, 3)], np.int32)
"""The two triangles of a quadrilateral, counter-clockwise."""


def square(side: float, texture: Bytes | None = None, repeats: float = 1.0) -> tuple[Part, ...]:
    """A white square in z = 0 that faces +z, in scene units, its uv from (0, 0) at the lower left to `repeats`."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64)
    return (_part(np.append(corners * side / 2, np.zeros((4, 1)), axis=1), (0, 0, 1), corners, texture, repeats),)


def box(centre: tuple[float, float, float], side: float) -> tuple[Part, ...]:
    """A white axis-parallel cube, six parts."""
    parts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            u, v, out = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3], sign * np.eye(3)[axis]
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) @ np.stack([u, v]) + out
            corners = corners if sign > 0 else corners[::-1]
            parts.append(_part(np.asarray(centre) + side / 2 * corners, tuple(out), corners[:, :2], None, 1.0))
    return tuple(parts)


def ball(radius: float) -> tuple[Part, ...]:
    """A white sphere of 80 large faces and smooth normals: between its corners these are much shorter than 1."""
    mesh = trimesh.creation.icosphere(subdivisions=1)
    corners = np.asarray(mesh.vertices, np.float32)
    return (Part(radius * corners, corners, np.asarray(mesh.faces, np.int32), None, np.ones(4, np.float32), None),)


def _part(
    vertices: Doubles, normal: tuple[float, ...], corners: Doubles, texture: Bytes | None, repeats: float
) -> Part:
    return Part(
        vertices=vertices.astype(np.float32),
        normals=np.tile(np.array(normal, np.float32), (4, 1)),
        faces=SIDES,
        uv=None if texture is None else (repeats * (corners + 1) / 2).astype(np.float32),
        color=np.ones(4, np.float32),
        texture=texture,
    )


SIDE = 8
NEVER = 1e4
"""A lead of the first label that no image makes up for: such attacks run through all their steps."""


def linear_network(
    scale: float = 1.0, classes: int = 4, lead: float = 0.0, dtype: torch.dtype = torch.float32
) -> Classifier:
    """Scores that are linear in the pixels of an 8×8 image, times `scale`; the same weights every time.

    `lead` is added to the first label's score; with a large one no image can change the answer.
    """
    layer = nn.Linear(3 * SIDE * SIDE, classes).requires_grad_(False)
    random = torch.Generator().manual_seed(11)
    layer.weight.copy_(scale * torch.randn(layer.weight.shape, generator=random) / SIDE)
    layer.bias.copy_(scale * torch.randn(layer.bias.shape, generator=random))
    layer.bias[0] += lead
    return Classifier(
        name="linear",
        network=nn.Sequential(nn.Flatten(), layer),
        labels=tuple(f"label {k}" for k in range(classes)),
        input_size=(SIDE, SIDE),
        mean=(0.5, 0.5, 0.5),
        std=(1.0, 1.0, 1.0),
        weights_sha256="0" * 64,
        dtype=dtype,
    )


def pixels() -> ImageRenderer:
    """An image of 8×8 random pixels, away from black and white."""
    random = torch.Generator().manual_seed(5)
    return ImageRenderer(0.2 + 0.6 * torch.rand(SIDE, SIDE, 3, generator=random), "random numbers")


def linear_problem(
    renderer: Renderer,
    groups: tuple[str, ...] | None = None,
    lead: float = NEVER,
    truncation: float | None = None,
    distance_weight: float = 0.0,
) -> AttackProblem:
    """The problem of leaving the first of the network's two labels. `groups` None: those that it is compiled for."""
    network = linear_network(classes=2, lead=lead)
    limits = Limits.of(renderer, groups or renderer.plan.groups, truncation=truncation)
    return AttackProblem.of(renderer, network, ResolvedGoal((0,), None), limits, distance_weight=distance_weight)


def attacked(problem: AttackProblem, attack: Attack, delta: Tensor | None = None) -> AttackRun:
    """An attack after all its steps, from the perturbation `delta` [total] if there is one. Raises Broken where it
    stopped before, or a row of its trace is not finite."""
    run = AttackRun.begin_or_resume(problem, attack, Verifier.of(problem))
    if delta is not None:
        run.state["delta"] = delta
    run_attack(run)
    need(run.step == attack.steps, f"it stopped after {run.step} steps")
    for row in run.trace:
        need(all(isfinite(value) for value in (row.loss, row.advantage, row.distance)), "a row is not finite")
    return run


def linear_gradient() -> Tensor:
    """∂(z₀ − z₁)/∂pixel of the network with two classes, float64 [8, 8, 3]: a closed form for every difference."""
    weight = linear_network(classes=2).network.get_parameter("1.weight").double()
    return (weight[0] - weight[1]).reshape(3, SIDE, SIDE).permute(1, 2, 0)
