"""From the radiance of covered pixels to a displayed image, and from images of parameters to covered pixels.

Each is one step of a graph with a derivative of its own: an image is drawn and derived hundreds of times, and a dozen
small steps cost more than the shading of a small object.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from services.rendering.color import display_derivative, to_display
from services.rendering.kernels import compiled


@dataclass(frozen=True)
class Canvas:
    """Where an image [H, W] is covered: `pixels` [P] (each once), and there `base_color` [P, 3], linear, and `coverage`
    [P, 1] in [0,1]; elsewhere, and under it, the `ground` [3], as displayed. All but `pixels` of one dtype.
    """

    size: tuple[int, int]
    pixels: Tensor
    base_color: Tensor
    coverage: Tensor
    ground: Tensor

    @cached_property
    def under(self) -> Tensor:
        """What shows of the ground beside each pixel's object [P, 3]."""
        return (1 - self.coverage) * self.ground

    @cached_property
    def empty(self) -> Tensor:
        """The ground alone [H·W, 3]."""
        height, width = self.size
        return self.ground.expand(height * width, 3).contiguous()

    def covered(self, values: Tensor) -> Tensor:
        """Those of `values` [H, W, C] that are covered, [P, C]. Differentiable."""
        result: Tensor = _Covered.apply(values, self.pixels)  # type: ignore[no-untyped-call]
        return result

    def image(self, radiance: Tensor) -> Tensor:
        """The displayed image [H, W, 3] of radiance [P, 3] per unit of base colour. Differentiable (once)."""
        result: Tensor = _Image.apply(radiance, self)  # type: ignore[no-untyped-call]
        return result


def over_ground(radiance: Tensor, exposure: float, ground: Tensor) -> Tensor:
    """Displayed images [..., 3] of radiance times coverage, and coverage, [..., 4], over a `ground` [3], displayed.

    `exposure` makes radiance linear display values. In radiance's dtype. Differentiable in radiance.
    """
    ground = ground.to(radiance.dtype)
    if compiled.runs(radiance) and not radiance.requires_grad:  # renderers that rasterise have no derivative to lose
        shown = radiance.new_empty(*radiance.shape[:-1], 3)
        of = (shown.numel() // 3, radiance.contiguous(), exposure, ground)
        compiled.call("over_ground", radiance.dtype, *of, shown, compiled.threads())
        return shown
    coverage = radiance[..., 3:]
    surface = to_display(exposure * radiance[..., :3] / coverage.clamp_min(1e-6))
    return surface * coverage + ground * (1 - coverage)


class _Covered(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, pixels: Tensor) -> Tensor:
        ctx.save_for_backward(pixels)
        ctx.shape = values.shape
        return values.reshape(-1, values.shape[-1]).index_select(0, pixels)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_output: Tensor) -> tuple[Tensor, None]:
        # Each pixel stands there once, so that nothing has to be added up.
        [pixels] = ctx.saved_tensors
        whole = grad_output.new_zeros(ctx.shape)
        whole.view(-1, ctx.shape[-1]).index_copy_(0, pixels, grad_output)
        return whole, None


class _Image(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, radiance: Tensor, canvas: Canvas) -> Tensor:
        radiance = radiance.contiguous()
        ctx.canvas = canvas
        ctx.save_for_backward(radiance)
        image = canvas.empty.clone()
        if compiled.runs(radiance):
            of = (canvas.base_color, canvas.coverage, canvas.under, canvas.pixels)
            compiled.call("composite", radiance.dtype, len(radiance), radiance, *of, image, compiled.threads())
        else:
            shown = to_display(radiance * canvas.base_color)
            image.index_copy_(0, canvas.pixels, torch.addcmul(canvas.under, canvas.coverage, shown))
        return image.reshape(*canvas.size, 3)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_output: Tensor) -> tuple[Tensor, None]:
        [radiance] = ctx.saved_tensors
        canvas: Canvas = ctx.canvas
        grad_output = grad_output.reshape(-1, 3).contiguous()
        if compiled.runs(radiance):
            found = torch.empty_like(radiance)
            of = (canvas.base_color, canvas.coverage, canvas.pixels, grad_output)
            compiled.call("composite_backward", radiance.dtype, len(radiance), radiance, *of, found, compiled.threads())
            return found, None
        steep = display_derivative(radiance * canvas.base_color) * canvas.base_color
        return grad_output.index_select(0, canvas.pixels) * canvas.coverage * steep, None
