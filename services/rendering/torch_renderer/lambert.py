"""The shading sum of surfaces that reflect the same share of the light in every direction.

Such a surface looks the same from every side, so that a near viewer costs no more than a distant one, and each pair of
pixel and direction costs a cosine: an eighth of the sum over a material's lobes (a floor of 70,000 pixels).
"""

from math import log
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from services.rendering.kernels import compiled
from services.rendering.torch_renderer import dsbrdf
from services.rendering.torch_renderer.dsbrdf import MATERIAL_UNIT

CHUNK = 2**18
"""Number of normals times directions per chunk in torch."""
DARK, LEVEL, FLAT = log(1e-4), 0.01, log(1e-2)
"""Largest log κ of a lobe that counts as dark; largest range of log κ and largest log γ of one that counts as constant.
They only choose the materials whose error is then measured."""


def albedo(material: Tensor) -> Tensor | None:
    """Returns the reflectance [3], in 1/steradian, of coefficients [3, lobes, 2, 6] in the group's units, if it is
    nearly the same for all directions; else None."""
    log_kappa, log_gamma = (material / MATERIAL_UNIT).unbind(-2)
    dark = log_kappa.amax(-1) <= DARK
    level = (log_kappa.amax(-1) - log_kappa.amin(-1) <= LEVEL) & (log_gamma.amax(-1) <= FLAT)
    if not bool((dark | level).all()):
        return None
    # γ log n·h is about -γ / 2 in the mean over a hemisphere of light.
    exponent = (log_kappa.mean(-1) - 0.5 * log_gamma.mean(-1).exp()).clamp_max(dsbrdf.LOG_EXPONENT_RANGE[1]).exp()
    return (torch.expm1(exponent) * ~dark).sum(-1)


def radiance(normals: Tensor, light: Tensor, towards: Tensor, visibility: Tensor | None = None) -> Tensor:
    """Sums Σ_ω light · max(0, n·ω) · visibility at each pixel, [P, 3].

    normals are unit vectors [P, 3]; light [3, D] is radiance times solid angle times reflectance; `towards` holds the
    directions to the light [3, D]; all have one dtype. It is differentiable (once) in normals and light. `visibility`
    is uint8 [D, P] in units of 1/255, None where nothing is hidden.
    """
    result: Tensor = _Radiance.apply(  # type: ignore[no-untyped-call]
        normals.contiguous(), light.contiguous(), towards, visibility
    )
    return result


def transport(normals: Tensor, towards: Tensor, visibility: Tensor | None = None) -> Tensor:
    """Returns max(0, n·ω) · visibility of every direction and pixel, [1, D, P]: what `radiance` sums per unit of light,
    the same in all channels. Arguments are those of `radiance`."""
    out = normals.new_empty(1, towards.shape[1], len(normals))
    for some in _parts(normals, towards):
        out[0, :, some] = _cosines(normals, towards, visibility, some)[0].T
    return out


class _Radiance(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, normals: Tensor, light: Tensor, towards: Tensor, visibility: Tensor | None) -> Tensor:
        ctx.save_for_backward(normals, light, towards, visibility)
        if compiled.runs(normals):
            result = torch.empty_like(normals)
            compiled.call(
                "lambert", normals.dtype, _packed(normals, light, towards, visibility), result, compiled.threads()
            )
            return result
        return torch.cat([_cosines(normals, towards, visibility, p)[0] @ light.T for p in _parts(normals, towards)])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        normals, light, towards, visibility = ctx.saved_tensors
        gradient = gradient.contiguous()
        d_normals, d_light = torch.zeros_like(normals), torch.zeros_like(light)
        if compiled.runs(normals):
            packed = _packed(normals, light, towards, visibility)
            compiled.call("lambert_backward", normals.dtype, packed, gradient, d_light, d_normals, compiled.threads())
        else:
            for some in _parts(normals, towards):
                cosines, reaches = _cosines(normals, towards, visibility, some)
                d_light += gradient[some].T @ cosines
                d_normals[some] = (gradient[some] @ light * reaches) @ towards.T
        return d_normals, d_light, None, None


def _parts(normals: Tensor, towards: Tensor) -> list[slice]:
    step = max(16, CHUNK // max(1, towards.shape[1]))
    return [slice(start, start + step) for start in range(0, max(1, len(normals)), step)]


def _cosines(normals: Tensor, towards: Tensor, visibility: Tensor | None, some: slice) -> tuple[Tensor, Tensor]:
    """Returns max(0, n·ω) · visibility, and the visibility above the horizon, [pixels, D]."""
    cosines = normals[some] @ towards
    reaches = (cosines > 0).to(cosines.dtype)
    if visibility is not None:
        reaches *= visibility[:, some].T.to(cosines.dtype) / 255
    return cosines * reaches, reaches


def _packed(normals: Tensor, light: Tensor, towards: Tensor, visibility: Tensor | None) -> Any:
    return compiled.structure(
        f"lambert.Irradiance.{compiled.NAMES[normals.dtype]}",
        count=len(normals),
        directions=towards.shape[1],
        normals=normals,
        towards=towards,
        light=light,
        visibility=visibility,
    )
