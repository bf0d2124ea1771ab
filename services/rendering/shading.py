"""The shading sum over all directions, and its derivatives, in a few buffers whatever the number of pixels.

Written as one autograd function. Left to autograd, a picture of 60,000 pixels and 512 directions keeps dozens of
tensors of 120 MB; recomputed chunk by chunk they still fragment the heap to 2.4 GB (measured). Here the backward pass
recomputes them in place.
"""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from services.rendering.dsbrdf import CHANNELS, COSINE_FLOOR, LOBES, LOG_EXPONENT_RANGE

CHUNK = 2**18
"""Pixels times directions at once: buffers of 1 MB in float32, which stay in the processor's cache."""


def radiance(normals: Tensor, light: Tensor, log_kappa: Tensor, gamma: Tensor, towards: Tensor, half: Tensor) -> Tensor:
    """Σ_ω ρ(θ_h, θ_d) · light · max(0, n·ω), [P, 3].

    normals [P, 3]; light [3, D], radiance times solid angle per channel; log_kappa, gamma [3, LOBES, D] of one
    material; towards, half [3, D], light directions and half vectors. All of one dtype. Differentiable (once) in the
    first four; gradients are zero where n·ω < 0, n·h < COSINE_FLOOR and where a lobe is cut (LOG_EXPONENT_RANGE).
    """
    result: Tensor = _Radiance.apply(normals, light, log_kappa, gamma, towards, half)  # type: ignore[no-untyped-call]
    return result


class _Radiance(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Tensor) -> Tensor:
        ctx.save_for_backward(*inputs)
        normals, light, log_kappa, gamma, towards, half = inputs
        result = torch.empty_like(normals)
        step = _pixels_at_once(light)
        buffers = normals.new_empty(4, step, light.shape[1])
        for start in range(0, len(normals), step):
            n, out = normals[start : start + step], result[start : start + step]
            cosine, log_half, lobe, rho = buffers[:, : len(n)]
            torch.mm(n, towards, out=cosine).clamp_min_(0.0)
            torch.mm(n, half, out=log_half).clamp_min_(COSINE_FLOOR).log_()
            for c in range(CHANNELS):
                rho.zero_()
                for l in range(LOBES):
                    torch.addcmul(log_kappa[c, l], gamma[c, l], log_half, out=lobe)
                    rho += lobe.clamp_(*LOG_EXPONENT_RANGE).exp_().expm1_()
                out[:, c] = rho.mul_(cosine) @ light[c]
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        """With A = slope · light · max(0, n·ω) and x = log κ + γ log n·h, so that ρ = Σ exp(exp x) − 1:

        d log κ = Σ_pixels A exp(exp x) exp x,  d γ = the same with log n·h,  d log n·h = Σ_lobes A exp(exp x) exp x γ.
        """
        normals, light, log_kappa, gamma, towards, half = ctx.saved_tensors
        of_normals, of_light, of_lobes = (
            ctx.needs_input_grad[0],
            ctx.needs_input_grad[1],
            any(ctx.needs_input_grad[2:4]),
        )
        d_normals, d_light = torch.zeros_like(normals), torch.zeros_like(light)
        d_log_kappa, d_gamma = torch.zeros_like(log_kappa), torch.zeros_like(gamma)
        cut = log_kappa.amax() >= LOG_EXPONENT_RANGE[1]
        step = _pixels_at_once(light)
        buffers = normals.new_empty(9, step, light.shape[1])
        for start in range(0, len(normals), step):
            n, g = normals[start : start + step], slope[start : start + step]
            cosine, cosine_half, log_half, x, lobe, rho, weight, d_cosine, d_log_half = buffers[:, : len(n)]
            torch.mm(n, towards, out=cosine).clamp_min_(0.0)
            torch.mm(n, half, out=cosine_half).clamp_min_(COSINE_FLOOR)
            torch.log(cosine_half, out=log_half)
            d_cosine.zero_()
            d_log_half.zero_()
            for c in range(CHANNELS):
                rho.zero_()
                torch.mul(g[:, c, None], light[c], out=weight)
                if of_normals or of_lobes:
                    weight.mul_(cosine)
                for l in range(LOBES):
                    torch.addcmul(log_kappa[c, l], gamma[c, l], log_half, out=x).clamp_(*LOG_EXPONENT_RANGE)
                    saturated = x == LOG_EXPONENT_RANGE[1] if cut else None
                    torch.expm1(x.exp_(), out=lobe)
                    rho += lobe
                    if of_normals or of_lobes:
                        x.mul_(lobe.add_(1.0)).mul_(weight)
                        if saturated is not None:
                            x.masked_fill_(saturated, 0.0)
                        if of_normals:
                            d_log_half.addcmul_(x, gamma[c, l])
                        if of_lobes:
                            d_log_kappa[c, l] += x.sum(0)
                            d_gamma[c, l] += x.mul_(log_half).sum(0)
                if of_light:
                    d_light[c] += g[:, c] @ torch.mul(rho, cosine, out=lobe)
                if of_normals:
                    d_cosine.addcmul_(rho.mul_(light[c]), g[:, c, None])
            if of_normals:
                d_cosine.masked_fill_(cosine <= 0, 0.0)
                d_log_half.div_(cosine_half).masked_fill_(cosine_half <= COSINE_FLOOR, 0.0)
                d_normals[start : start + step] = d_cosine @ towards.T + d_log_half @ half.T
        return (
            d_normals if of_normals else None,
            d_light if of_light else None,
            d_log_kappa if of_lobes else None,
            d_gamma if of_lobes else None,
            None,
            None,
        )


def _pixels_at_once(light: Tensor) -> int:
    return max(16, CHUNK // light.shape[1])
