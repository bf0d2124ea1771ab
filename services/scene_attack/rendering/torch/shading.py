"""The shading sums over all directions, and their derivatives, in a fixed number of buffers.

`radiance` and `transport` are for a distant viewer: radiance is a function of the normal alone. Each sum is one
autograd function with a backward pass of its own. Left to autograd, an image of 60,000 pixels and 512 directions keeps
dozens of tensors of 120 MB; recomputed chunk by chunk they still fragment the heap to 2.4 GB (measured). Here the
backward pass recomputes them in place: in the compiled kernels where they are available, else in torch, which computes
the same sum on any device.

`perspective_radiance` is for a viewer at a finite distance, where half vectors and lobes differ from pixel to pixel.
Radiance is then no function of the normal alone and cannot be tabulated, so it is summed pixel by pixel: in the
compiled kernels, else in torch by chunks whose graph is rebuilt in the backward pass.

`lambert_radiance` and `lambert_transport` are for surfaces that reflect the same share of the light in every direction
(`albedo`). Such a surface looks the same from every side, so that a near viewer costs no more than a distant one, and
each pair of pixel and direction costs a cosine: an eighth of the sum over a material's lobes (a floor of 70,000
pixels).
"""

import ctypes
from dataclasses import dataclass
from math import log
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import normalize

from scene_attack.rendering.kernels import compiled
from scene_attack.rendering.torch import dsbrdf
from scene_attack.rendering.torch.dsbrdf import COSINE_FLOOR, LOG_EXPONENT_RANGE, MATERIAL_UNIT

CHUNK = 2**18
"""Number of normals times directions per chunk: buffers of 1 MB in float32, which fit in the processor's cache."""


@dataclass(frozen=True)
class Directions:
    """Directions to the light and their half vectors, of one dtype.

    towards: unit vectors to the light [3, D]. half: half vectors [4, D]; the fourth row is ½ for light from straight
    behind, where the half vector is zero, and 0 elsewhere, so that 1 − n·h = ½|n − h|² + half[3].
    """

    towards: Tensor
    half: Tensor

    @classmethod
    def of(cls, towards: Tensor, half: Tensor) -> "Directions":
        """Makes them from unit vectors to the light and half vectors, both [D, 3]."""
        nowhere = 0.5 * (half == 0).all(dim=-1, keepdim=True)
        return cls(towards.T.contiguous(), torch.cat([half, nowhere.to(half.dtype)], dim=-1).T.contiguous())

    def to(self, dtype: torch.dtype) -> "Directions":
        """Returns the same directions in another dtype."""
        return Directions(self.towards.to(dtype), self.half.to(dtype))

    def only(self, kept: Tensor) -> "Directions":
        """Returns the directions at the indices `kept`."""
        return Directions(self.towards[:, kept].contiguous(), self.half[:, kept].contiguous())


@dataclass(frozen=True)
class Lobes:
    """A material's lobes at each direction: ρ = base + tilt · log n·h + Σ_lobes exp(κ (n·h)^γ) − 1.

    log_kappa, gamma: [C, lobes, D]. base, tilt: [C, D], the sum of the lobes that are approximated by a straight line
    in log n·h. C is 3, or 1 where the three colour channels are the same.
    """

    base: Tensor
    tilt: Tensor
    log_kappa: Tensor
    gamma: Tensor


def radiance(
    normals: Tensor, light: Tensor, lobes: Lobes, directions: Directions, visibility: Tensor | None = None
) -> Tensor:
    """Sums Σ_ω ρ(θ_h, θ_d) · light · max(0, n·ω) · visibility at each normal, [N, 3].

    normals are unit vectors [N, 3]; light [3, D] is radiance times solid angle per channel; all have one dtype. The sum
    is differentiable (once) in normals (only the gradient's component tangential to the sphere is meaningful), light,
    log κ and γ. Gradients are zero where n·ω < 0, where n·h < COSINE_FLOOR and where a lobe is clamped
    (LOG_EXPONENT_RANGE). `visibility` is uint8 [D, N] in units of 1/255, None where nothing is hidden.
    """
    of_lobes = lobes.log_kappa, lobes.gamma, lobes.base, lobes.tilt
    result: Tensor = _Distant.apply(  # type: ignore[no-untyped-call]
        normals, light, *of_lobes, directions.towards, directions.half, visibility
    )
    return result


def transport(normals: Tensor, lobes: Lobes, directions: Directions, visibility: Tensor | None = None) -> Tensor:
    """Returns ρ(θ_h, θ_d) · max(0, n·ω) · visibility of every direction and normal, [C, D, N]: radiance per unit of
    light. For `visibility` see `radiance`."""
    out = normals.new_empty(len(lobes.base), directions.towards.shape[1], len(normals))
    if compiled.runs(normals):
        of_lobes = lobes.log_kappa, lobes.gamma, lobes.base, lobes.tilt
        packed = _packed(normals, None, *of_lobes, directions.towards, directions.half, visibility)
        compiled.call("transport", normals.dtype, packed, out, compiled.threads())
        return out
    for some in _chunks(normals, out.shape[1], CHUNK):
        n = normals[some]
        cosine, log_half = (n @ directions.towards).clamp_min_(0.0), _log_half(n, directions.half)
        if visibility is not None:
            cosine *= _seen(visibility, some, cosine.dtype)
        for c in range(len(out)):
            rho = torch.addcmul(lobes.base[c], lobes.tilt[c], log_half)
            for log_kappa, gamma in zip(lobes.log_kappa[c], lobes.gamma[c], strict=True):
                rho += torch.addcmul(log_kappa, gamma, log_half).clamp_(*LOG_EXPONENT_RANGE).exp_().expm1_()
            out[c, :, some] = rho.mul_(cosine).T
    return out


class _Distant(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Tensor) -> Tensor:
        ctx.save_for_backward(*inputs)
        normals, light, log_kappa, gamma, base, tilt, towards, half, visibility = inputs
        result = torch.empty_like(normals)
        if compiled.runs(normals):
            packed = _packed(*inputs)
            compiled.call("shade", normals.dtype, packed, result, compiled.threads())
            return result
        chunks = _chunks(normals, light.shape[1], CHUNK)
        buffers = normals.new_empty(3, chunks[0].stop, light.shape[1])
        for some in chunks:
            n, out = normals[some], result[some]
            cosine, lobe, rho = buffers[:, : len(n)]
            torch.mm(n, towards, out=cosine).clamp_min_(0.0)
            if visibility is not None:
                cosine *= _seen(visibility, some, cosine.dtype)
            log_half = _log_half(n, half)
            for c in range(3):
                if c < len(base):
                    torch.addcmul(base[c], tilt[c], log_half, out=rho)
                    for l in range(log_kappa.shape[1]):
                        torch.addcmul(log_kappa[c, l], gamma[c, l], log_half, out=lobe)
                        rho += lobe.clamp_(*LOG_EXPONENT_RANGE).exp_().expm1_()
                    rho.mul_(cosine)
                out[:, c] = rho @ light[c]
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        inputs = ctx.saved_tensors
        of_normals, of_light, of_kappa, of_gamma = ctx.needs_input_grad[:4]
        normals, light, log_kappa, gamma = inputs[:4]
        d_normals, d_light = torch.zeros_like(normals), torch.zeros_like(light)
        d_kappa, d_gamma = torch.zeros_like(log_kappa), torch.zeros_like(gamma)
        if compiled.runs(normals):
            packed = _packed(*inputs)
            rows = (d_light, d_kappa, d_gamma, d_normals if of_normals else None)
            compiled.call("shade_backward", normals.dtype, packed, gradient.contiguous(), *rows, compiled.threads())
        else:
            _gradients(inputs, gradient, of_normals, of_kappa or of_gamma, (d_normals, d_light, d_kappa, d_gamma))
        return (
            d_normals if of_normals else None,
            d_light if of_light else None,
            d_kappa if of_kappa else None,
            d_gamma if of_gamma else None,
            *(None,) * (len(inputs) - 4),
        )


def _gradients(
    inputs: tuple[Tensor, ...], gradient: Tensor, of_normals: bool, of_lobes: bool, into: tuple[Tensor, ...]
) -> None:
    """Writes the gradients with respect to (normals, light, log κ, γ) to `into`.

    With A = gradient · light · max(0, n·ω) and x = log κ + γ log n·h, so that ρ = base + Σ exp(exp x) − 1:

    d log κ = Σ_normals A exp(exp x) exp x,  d γ = the same with log n·h,  d log n·h = Σ_lobes A exp(exp x) exp x γ.
    """
    normals, light, log_kappa, gamma, base, tilt, towards, half, visibility = inputs
    d_normals, d_light, d_kappa, d_gamma = into
    channels = len(base)
    chunks = _chunks(normals, light.shape[1], CHUNK)
    buffers = normals.new_empty(7, chunks[0].stop, light.shape[1])
    for some in chunks:
        n, g = normals[some], gradient[some]
        cosine, x, lobe, rho, lit, weight, d_log_half = buffers[:, : len(n)]
        torch.mm(n, towards, out=cosine).clamp_min_(0.0)
        share = None if visibility is None else _seen(visibility, some, cosine.dtype)
        log_half = _log_half(n, half)
        d_cosine = torch.zeros_like(cosine)
        d_log_half.zero_()
        for c in range(channels):
            # one channel stands for all three: add up their weights
            torch.mm(g, light, out=lit) if channels == 1 else torch.mul(g[:, c, None], light[c], out=lit)
            if share is not None:
                lit.mul_(share)
            torch.mul(lit, cosine, out=weight)
            d_log_half.addcmul_(weight, tilt[c])
            torch.addcmul(base[c], tilt[c], log_half, out=rho)
            for l in range(log_kappa.shape[1]):
                torch.addcmul(log_kappa[c, l], gamma[c, l], log_half, out=x)
                saturated = x >= LOG_EXPONENT_RANGE[1]
                torch.expm1(x.clamp_(*LOG_EXPONENT_RANGE).exp_(), out=lobe)
                rho += lobe
                if of_normals or of_lobes:
                    x.mul_(lobe.add_(1.0)).mul_(weight).masked_fill_(saturated, 0.0)
                    d_log_half.addcmul_(x, gamma[c, l])
                    d_kappa[c, l] += x.sum(0)
                    d_gamma[c, l] += x.mul_(log_half).sum(0)
            d_cosine.addcmul_(rho, lit)
            rho.mul_(cosine if share is None else cosine * share)
            for k in range(3) if channels == 1 else (c,):
                d_light[k] += g[:, k] @ rho
        if of_normals:
            cosine_half = log_half.exp()
            d_cosine.masked_fill_(cosine <= 0, 0.0)
            d_log_half.div_(cosine_half).masked_fill_(cosine_half <= COSINE_FLOOR * (1 + 1e-6), 0.0)
            d_normals[some] = d_cosine @ towards.T + d_log_half @ half[:3].T


def _log_half(normals: Tensor, half: Tensor) -> Tensor:
    """Returns log n·h [N, D] with n·h clamped to at least COSINE_FLOOR.

    It is computed in float64 from vectors normalised in float64, as a lobe of γ = 1e5 varies where 1 − n·h is 1e-5.
    """
    wide = torch.mm(normalize(normals.double(), dim=-1), normalize(half[:3].double(), dim=0))
    return wide.clamp_(COSINE_FLOOR, 1.0).log_().to(normals.dtype)


def _seen(visibility: Tensor, some: slice, dtype: torch.dtype) -> Tensor:
    """Returns the visibility [N, D], in [0,1], of some normals."""
    return visibility[:, some].T.to(dtype) / 255


def _packed(
    normals: Tensor,
    light: Tensor | None,
    log_kappa: Tensor,
    gamma: Tensor,
    base: Tensor,
    tilt: Tensor,
    towards: Tensor,
    half: Tensor,
    visibility: Tensor | None = None,
) -> ctypes.Structure:
    tensors = {"half": half, "light": light, "base": base, "tilt": tilt, "log_kappa": log_kappa, "gamma": gamma}
    sizes = {"channels": len(base), "lobes": log_kappa.shape[1]}
    return _structure("shading.Scene", normals, towards, visibility, **tensors, **sizes, **LIMITS)


LIMITS = {"cosine_floor": COSINE_FLOOR, "lowest": LOG_EXPONENT_RANGE[0], "highest": LOG_EXPONENT_RANGE[1]}
"""Limits of the lobes' arguments, as the kernels take them."""


def _structure(
    name: str, normals: Tensor, towards: Tensor, visibility: Tensor | None, **others: Tensor | float | None
) -> ctypes.Structure:
    """Returns the arguments of a sum as its kernel takes them: those that every sum has, and `others`."""
    values = {"normals": normals, "towards": towards, "visibility": visibility} | others
    return compiled.structure(
        f"{name}.{compiled.NAMES[normals.dtype]}",
        count=len(normals),
        directions=towards.shape[1],
        **{name: value.contiguous() if isinstance(value, Tensor) else value for name, value in values.items()},
    )


def _chunks(normals: Tensor, directions: int, pairs: int) -> list[slice]:
    """Returns parts of the normals, in order, each of at most `pairs` / `directions` of them, or 16."""
    step = max(16, pairs // max(1, directions))
    return [slice(start, start + step) for start in range(0, max(1, len(normals)), step)]


PERSPECTIVE_CHUNK = 2**16
"""Number of pixels times directions per chunk in torch, where each pair stores about a hundred numbers."""


def perspective_radiance(
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
    result: Tensor = _Perspective.apply(  # type: ignore[no-untyped-call]
        normals, viewers, light, material, towards, visibility
    )
    return result


class _Perspective(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        held: tuple[Any, ...] = tuple(None if value is None else value.contiguous() for value in inputs)
        ctx.save_for_backward(*held)
        normals, viewers, light, material, towards, visibility = held
        if compiled.runs(normals):
            result = torch.empty_like(normals)
            compiled.call("shade_perspective", normals.dtype, _packed_perspective(*held), result, compiled.threads())
            return result
        chunks = _chunks(normals, towards.shape[1], PERSPECTIVE_CHUNK)
        return torch.cat(
            [_summed(normals[some], light, material, viewers, towards, visibility, some) for some in chunks]
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        normals, viewers, light, material, towards, visibility = ctx.saved_tensors
        gradients = [torch.zeros_like(value) for value in (light, material, normals)]
        gradient = gradient.contiguous()
        if compiled.runs(normals):
            packed = _packed_perspective(normals, viewers, light, material, towards, visibility)
            compiled.call("shade_perspective_backward", normals.dtype, packed, gradient, *gradients, compiled.threads())
        else:
            for some in _chunks(normals, towards.shape[1], PERSPECTIVE_CHUNK):
                leaves = [value.detach().requires_grad_() for value in (normals[some], light, material)]
                with torch.enable_grad():
                    shaded = _summed(leaves[0], leaves[1], leaves[2], viewers, towards, visibility, some)
                d_normals, d_light, d_material = torch.autograd.grad(shaded, leaves, gradient[some])
                gradients[0] += d_light
                gradients[1] += d_material
                gradients[2][some] = d_normals
        return gradients[2], None, gradients[0], gradients[1], None, None


def _summed(
    normals: Tensor,
    light: Tensor,
    material: Tensor,
    viewers: Tensor,
    towards: Tensor,
    visibility: Tensor | None,
    some: slice,
) -> Tensor:
    """Computes the sum at some pixels, [P, 3], for all their pairs of pixel and direction at once. `normals` are those
    of these pixels; `viewers` and `visibility` are those of all.

    Angles are computed in float64, as a lobe of γ = 1e5 varies where 1 − n·h is 1e-5. Vectors are normalised in float64
    too: else the angle between two nearly parallel vectors would be off by 3e-4.
    """
    n, v, w = (
        normalize(normals.double(), dim=-1),
        normalize(viewers[some].double(), dim=-1),
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
    if visibility is not None:
        rho = rho * _seen(visibility, some, dtype)
    return torch.einsum("cpd,cd->pc", rho.expand(3, -1, -1), light)


def _packed_perspective(
    normals: Tensor, viewers: Tensor, light: Tensor, material: Tensor, towards: Tensor, visibility: Tensor | None
) -> ctypes.Structure:
    tensors = {"viewers": viewers, "light": light, "material": material}
    sizes = {"channels": len(material), "lobes": material.shape[1]}
    most = {"max_log_kappa": dsbrdf.LOG_KAPPA_RANGE[1], "max_log_gamma": dsbrdf.LOG_GAMMA_RANGE[1]}
    return _structure("perspective.Scene", normals, towards, visibility, **tensors, **sizes, **LIMITS, **most)


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


def lambert_radiance(normals: Tensor, light: Tensor, towards: Tensor, visibility: Tensor | None = None) -> Tensor:
    """Sums Σ_ω light · max(0, n·ω) · visibility at each pixel, [P, 3].

    normals are unit vectors [P, 3]; light [3, D] is radiance times solid angle times reflectance; `towards` holds the
    directions to the light [3, D]; all have one dtype. It is differentiable (once) in normals and light. `visibility`
    is uint8 [D, P] in units of 1/255, None where nothing is hidden.
    """
    result: Tensor = _Lambert.apply(  # type: ignore[no-untyped-call]
        normals.contiguous(), light.contiguous(), towards, visibility
    )
    return result


def lambert_transport(normals: Tensor, towards: Tensor, visibility: Tensor | None = None) -> Tensor:
    """Returns max(0, n·ω) · visibility by direction and pixel, [1, D, P]: the factors by which `lambert_radiance`
    multiplies the light, the same in all channels. Arguments are those of `lambert_radiance`.
    """
    out = normals.new_empty(1, towards.shape[1], len(normals))
    for some in _chunks(normals, towards.shape[1], CHUNK):
        out[0, :, some] = _cosines(normals, towards, visibility, some)[0].T
    return out


class _Lambert(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, normals: Tensor, light: Tensor, towards: Tensor, visibility: Tensor | None) -> Tensor:
        ctx.save_for_backward(normals, light, towards, visibility)
        if compiled.runs(normals):
            result = torch.empty_like(normals)
            packed = _structure("lambert.Irradiance", normals, towards, visibility, light=light)
            compiled.call("lambert", normals.dtype, packed, result, compiled.threads())
            return result
        chunks = _chunks(normals, towards.shape[1], CHUNK)
        return torch.cat([_cosines(normals, towards, visibility, some)[0] @ light.T for some in chunks])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        normals, light, towards, visibility = ctx.saved_tensors
        gradient = gradient.contiguous()
        d_normals, d_light = torch.zeros_like(normals), torch.zeros_like(light)
        if compiled.runs(normals):
            packed = _structure("lambert.Irradiance", normals, towards, visibility, light=light)
            compiled.call("lambert_backward", normals.dtype, packed, gradient, d_light, d_normals, compiled.threads())
        else:
            for some in _chunks(normals, towards.shape[1], CHUNK):
                cosines, reaches = _cosines(normals, towards, visibility, some)
                d_light += gradient[some].T @ cosines
                d_normals[some] = (gradient[some] @ light * reaches) @ towards.T
        return d_normals, d_light, None, None


def _cosines(normals: Tensor, towards: Tensor, visibility: Tensor | None, some: slice) -> tuple[Tensor, Tensor]:
    """Returns max(0, n·ω) · visibility, and the visibility above the horizon, [pixels, D]."""
    cosines = normals[some] @ towards
    reaches = (cosines > 0).to(cosines.dtype)
    if visibility is not None:
        reaches *= _seen(visibility, some, cosines.dtype)
    return cosines * reaches, reaches
