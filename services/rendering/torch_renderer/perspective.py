"""The shading sum for a viewer at a finite distance, where half vectors and lobes differ from pixel to pixel.

Radiance is then no function of the normal alone and cannot be tabulated, so it is summed pixel by pixel: in the
compiled kernels, else in torch by chunks whose graph is rebuilt in the backward pass.
"""

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import normalize

from services.rendering.kernels import compiled
from services.rendering.torch_renderer import dsbrdf

CHUNK = 2**16
"""Number of pixels times directions per chunk in torch, where each pair stores about a hundred numbers."""


def radiance(
    normals: Tensor,
    viewers: Tensor,
    light: Tensor,
    material: Tensor,
    towards: Tensor,
    visibility: Tensor | None = None,
) -> Tensor:
    """Sums Σ_ω ρ(θ_h, θ_d) · light · max(0, n·ω) · visibility at each pixel, [P, 3].

    normals and viewers are unit vectors [P, 3], the viewers towards the camera; light is [3, D], radiance times solid
    angle; material [C, LOBES, 2, 6] holds natural logarithms of κ and γ, with C = 1 where the channels are the same;
    `towards` holds the directions to the light [3, D]. The sum is differentiable (once) in normals (along the sphere),
    light and material. `visibility` is uint8 [D, P] in units of 1/255, None where nothing is hidden.
    """
    result: Tensor = _Radiance.apply(  # type: ignore[no-untyped-call]
        normals, viewers, light, material, towards, visibility
    )
    return result


class _Radiance(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        held: tuple[Any, ...] = tuple(None if value is None else value.contiguous() for value in inputs)
        ctx.save_for_backward(*held)
        normals, viewers, light, material, towards, visibility = held
        if compiled.runs(normals):
            result = torch.empty_like(normals)
            compiled.call("shade_perspective", normals.dtype, _packed(*held), result, compiled.threads())
            return result
        step = max(16, CHUNK // max(1, towards.shape[1]))
        parts = [slice(start, start + step) for start in range(0, len(normals), step)]
        return torch.cat(
            [_chunk(normals[p], viewers[p], light, material, towards, _shares(visibility, p)) for p in parts]
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        normals, viewers, light, material, towards, visibility = ctx.saved_tensors
        gradients = [torch.zeros_like(value) for value in (light, material, normals)]
        gradient = gradient.contiguous()
        if compiled.runs(normals):
            packed = _packed(normals, viewers, light, material, towards, visibility)
            compiled.call("shade_perspective_backward", normals.dtype, packed, gradient, *gradients, compiled.threads())
        else:
            step = max(16, CHUNK // max(1, towards.shape[1]))
            for start in range(0, len(normals), step):
                some = slice(start, start + step)
                leaves = [value.detach().requires_grad_() for value in (light, material, normals[some])]
                with torch.enable_grad():
                    seen = _shares(visibility, some)
                    shaded = _chunk(leaves[2], viewers[some], leaves[0], leaves[1], towards, seen)
                d_light, d_material, d_normals = torch.autograd.grad(shaded, leaves, gradient[some])
                gradients[0] += d_light
                gradients[1] += d_material
                gradients[2][some] = d_normals
        return gradients[2], None, gradients[0], gradients[1], None, None


def _shares(visibility: Tensor | None, some: slice) -> Tensor | None:
    """Returns the visible shares [D, P] of some pixels."""
    return None if visibility is None else visibility[:, some].double() / 255


def _chunk(
    normals: Tensor, viewers: Tensor, light: Tensor, material: Tensor, towards: Tensor, seen: Tensor | None
) -> Tensor:
    """Computes the sum at a chunk of pixels, [P, 3], for all pairs of pixel and direction at once; `seen` [D, P].

    Angles are computed in float64, as a lobe of γ = 1e5 varies where 1 − n·h is 1e-5. Vectors are normalised in float64
    too: else the angle between two nearly parallel vectors would be off by 3e-4.
    """
    n, v, w = (
        normalize(normals.double(), dim=-1),
        normalize(viewers.double(), dim=-1),
        normalize(towards.double(), dim=0),
    )
    between = v @ w  # cosine of 2 θ_d
    length = (2 + 2 * between).clamp_min(0.0).sqrt()
    nowhere = length < 1e-7  # light from straight behind: no half vector
    cosine = n @ w
    facing = (n * v).sum(-1, keepdim=True)
    half = torch.where(nowhere, 0.0, (facing + cosine) / torch.where(nowhere, 1.0, length))
    theta_d = torch.atan2((2 - 2 * between).clamp_min(0.0).sqrt(), length)
    dtype = normals.dtype
    curves = dsbrdf.basis(theta_d).to(dtype).flatten(0, 1)
    log_kappa, gamma = (curve.reshape(*curve.shape[:-1], *cosine.shape) for curve in dsbrdf.lobes(material, curves))
    log_half = half.clamp(dsbrdf.COSINE_FLOOR, 1.0).log().to(dtype)
    rho = dsbrdf.reflectance(log_half, log_kappa, gamma).sum(1) * cosine.clamp_min(0.0).to(dtype)
    if seen is not None:
        rho = rho * seen.T.to(dtype)
    return torch.einsum("cpd,cd->pc", rho.expand(3, -1, -1), light)


def _packed(
    normals: Tensor, viewers: Tensor, light: Tensor, material: Tensor, towards: Tensor, visibility: Tensor | None
) -> ctypes.Structure:
    lowest, highest = dsbrdf.LOG_EXPONENT_RANGE
    channels, lobes = material.shape[:2]
    return compiled.structure(
        f"perspective.Scene.{compiled.NAMES[normals.dtype]}",
        count=len(normals),
        directions=towards.shape[1],
        channels=channels,
        lobes=lobes,
        normals=normals,
        viewers=viewers,
        towards=towards,
        light=light,
        material=material,
        visibility=visibility,
        cosine_floor=dsbrdf.COSINE_FLOOR,
        lowest=lowest,
        highest=highest,
        max_log_kappa=dsbrdf.LOG_KAPPA_RANGE[1],
        max_log_gamma=dsbrdf.LOG_GAMMA_RANGE[1],
    )
