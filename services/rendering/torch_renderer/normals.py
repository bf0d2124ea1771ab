"""Converts unit normals to the paper's two angles per pixel, and back.

The angles are of the camera's frame: polar angle θ from the camera's up axis (+y), azimuth φ about it from the axis
towards the viewer (+z) to the camera's right (+x), so n = (sin θ sin φ, cos θ, sin θ cos φ). A visible surface has
n·z > 0, hence φ in (−π/2, π/2), away from the jump at ±π; and the pole, where φ has no meaning, lies on the silhouette:
only surfaces seen exactly edge-on have a normal straight up. The pole is harmless: n is smooth in (θ, φ) everywhere and
its gradient with respect to φ goes to zero at the pole.
"""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from services.rendering.kernels import compiled

MAX_ANGLE = 100.0
"""Largest magnitude of an attacked angle, radians: 16 turns, more than 120 steps of the paper's size can reach. There
float32 resolves 8e-6 radians. At 1e6 it would resolve 0.06, and the float32 attack loop and the float64 verifier would
see different normals."""


def to_angles(vectors: Tensor) -> Tensor:
    """Returns azimuth and polar angle [..., 2], radians, of vectors [..., 3] in the camera's frame (of any length > 0).

    The azimuth is in [−π, π], and 0 at the poles; the polar angle is in [0, π]. The zero vector gives (0, 0).
    """
    x, y, z = vectors.unbind(-1)
    horizontal = torch.hypot(x, z)
    azimuth = torch.where(horizontal > 0, torch.atan2(x, z), 0.0)
    return torch.stack((azimuth, torch.atan2(horizontal, y)), dim=-1)


def to_vectors(angles: Tensor) -> Tensor:
    """Returns unit vectors [..., 3] in the camera's frame for azimuth and polar angle [..., 2], radians.

    The angles may have any finite values. It is differentiable; only once in float32 on the CPU, where a
    compiled kernel runs.
    """
    if angles.dtype == torch.float32 and compiled.runs(angles):
        result: Tensor = _Vectors.apply(angles.contiguous())  # type: ignore[no-untyped-call]
        return result
    azimuth, polar = angles.unbind(-1)
    horizontal = polar.sin()
    return torch.stack((horizontal * azimuth.sin(), polar.cos(), horizontal * azimuth.cos()), dim=-1)


class _Vectors(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, angles: Tensor) -> Tensor:
        ctx.save_for_backward(angles)
        found = angles.new_empty(*angles.shape[:-1], 3)
        compiled.call("vectors", angles.dtype, angles.numel() // 2, angles, found, compiled.threads())
        return found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        [angles] = ctx.saved_tensors
        found = torch.empty_like(angles)
        arguments = (angles.numel() // 2, angles, gradient.contiguous(), found)
        compiled.call("vectors_backward", angles.dtype, *arguments, compiled.threads())
        return found
