"""Linear radiance as displayed values (sRGB) and 8 bits, and the radiance of covered pixels as an image over the
ground.

Compositing and gathering are one autograd function each, with a backward pass of its own: an image is rendered and
differentiated hundreds of times, and a dozen small torch operations cost more than the shading of a small object.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from scene_attack.rendering.kernels import compiled

KNEE = 0.0031308
"""Linear value up to which the sRGB curve is a straight line (IEC 61966-2-1)."""


def to_display(linear: Tensor) -> Tensor:
    """Applies the sRGB curve (IEC 61966-2-1) to radiance of any shape, clipped to [0,1].

    It is differentiable (once); gradients are finite everywhere, and zero where values are clipped.
    """
    result: Tensor = _Display.apply(linear)  # type: ignore[no-untyped-call]
    return result


def display_derivative(linear: Tensor) -> Tensor:
    """Returns the derivative of `to_display`, of the same shape."""
    # The power is evaluated above the knee only, as its derivative at 0 is infinite.
    above = linear.clamp(KNEE, 1.0)
    derivative = torch.where(linear <= KNEE, 12.92, 1.055 / 2.4 * (above.log() * (1 / 2.4 - 1)).exp())
    return derivative * ((linear >= 0) & (linear <= 1))


class _Display(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, linear: Tensor) -> Tensor:
        ctx.save_for_backward(linear)
        if compiled.runs(linear):
            shown = torch.empty_like(linear, memory_format=torch.contiguous_format)
            compiled.call("display", linear.dtype, linear.numel(), linear.contiguous(), shown, compiled.threads())
            return shown
        clipped = linear.clamp(0.0, 1.0)
        # Computed by way of the logarithm: the last bits of torch's power in float32 depend on an element's position in
        # the tensor, so an image's bits would depend on its batch.
        curved = 1.055 * (clipped.clamp_min(KNEE).log() / 2.4).exp() - 0.055
        return torch.where(clipped <= KNEE, 12.92 * clipped, curved)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_output: Tensor) -> Tensor:
        return grad_output * display_derivative(*ctx.saved_tensors)


def to_bytes(images: Tensor) -> Tensor:
    """Rounds images in [0,1], of any shape, to uint8 (to nearest, ties to even)."""
    # In a 16-bit float type the product with 255 would be rounded itself, so values would be rounded twice.
    wide = images.detach().to(torch.promote_types(images.dtype, torch.float32))
    return (wide.clamp(0.0, 1.0) * 255).round().to(torch.uint8)


def quantize(images: Tensor) -> tuple[Tensor, Tensor]:
    """Rounds images in [0,1], of any shape, to 8 bits; returns them as uint8 and as float32 multiples of 1/255."""
    if images.dtype == torch.float32 and compiled.runs(images):
        plain = images.detach().contiguous()
        quantized, seen = torch.empty_like(plain, dtype=torch.uint8), torch.empty_like(plain)
        compiled.call("save", plain.dtype, plain.numel(), plain, quantized, seen, compiled.threads())
        return quantized, seen
    quantized = to_bytes(images)
    return quantized, from_bytes(quantized)


def from_bytes(images: Tensor) -> Tensor:
    """Converts uint8 images to float32 in [0,1]."""
    return images.to(torch.float32) / 255


def as_saved(images: Tensor) -> Tensor:
    """Rounds images in [0,1] to 8 bits; returns float32 multiples of 1/255, as read back from a saved file."""
    return quantize(images)[1]


@dataclass(frozen=True)
class Canvas:
    """The part of an image that objects cover, over a ground. All tensors but `pixels` have one dtype.

    size: the image's height and width H, W. pixels: flat indices of the covered pixels, int64 [P], each once.
    base_color: linear RGB of these pixels [P, 3]. coverage: their coverage [P, 1] in [0,1]. ground: the displayed
    colour behind the objects [3], or that of each pixel [H·W, 3].

    Where a pixel shows several surfaces it is listed once for each, with the share of each as its coverage, and
    `ranks` holds the places in the list, int64: of the first surface of each pixel, of the second of those that have
    one, and so on. It is empty where each pixel is listed once.
    """

    size: tuple[int, int]
    pixels: Tensor
    base_color: Tensor
    coverage: Tensor
    ground: Tensor
    ranks: tuple[Tensor, ...] = ()

    @property
    def n_pixels(self) -> int:
        """Number of covered pixels."""
        return len(self.ranks[0]) if self.ranks else len(self.pixels)

    @cached_property
    def behind(self) -> Tensor:
        """The ground of the covered pixels, [3] or [P, 3]."""
        return self.ground if self.ground.dim() == 1 else self.ground[self.pixels]

    @cached_property
    def under(self) -> Tensor:
        """The ground's contribution to each covered pixel, (1 − coverage) · ground, [P, 3]."""
        return (1 - self.coverage) * self.behind

    @cached_property
    def empty(self) -> Tensor:
        """An image of the ground alone, [H·W, 3]."""
        height, width = self.size
        return self.ground.expand(height * width, 3).contiguous()

    def covered(self, values: Tensor) -> Tensor:
        """Gathers the covered pixels of `values` [H, W, C]: [P, C]. It is differentiable (once)."""
        result: Tensor = _Covered.apply(values, self.pixels, self.ranks)  # type: ignore[no-untyped-call]
        return result

    def image(self, radiance: Tensor) -> Tensor:
        """Composites radiance [P, 3] per unit of base colour; returns the displayed image [H, W, 3].

        It is differentiable (once).
        """
        result: Tensor = _Image.apply(radiance, self)  # type: ignore[no-untyped-call]
        return result


def over_ground(radiance: Tensor, exposure: float, ground: Tensor) -> Tensor:
    """Composites images over a `ground`, a displayed colour [3] or an image [H, W, 3]; returns displayed images
    [..., 3].

    `radiance` [..., 4] holds RGB radiance times coverage, and coverage. `exposure` is the factor from radiance to
    linear display values. The result has the dtype of `radiance` and is differentiable in it.
    """
    ground = ground.to(radiance.dtype)
    # The kernel has no backward pass, and takes one colour.
    if ground.dim() == 1 and compiled.runs(radiance) and not radiance.requires_grad:
        shown = radiance.new_empty(*radiance.shape[:-1], 3)
        inputs = (shown.numel() // 3, radiance.contiguous(), exposure, ground)
        compiled.call("over_ground", radiance.dtype, *inputs, shown, compiled.threads())
        return shown
    coverage = radiance[..., 3:]
    surface = to_display(exposure * radiance[..., :3] / coverage.clamp_min(1e-6))
    return surface * coverage + ground * (1 - coverage)


class _Covered(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, values: Tensor, pixels: Tensor, ranks: tuple[Tensor, ...]) -> Tensor:
        ctx.save_for_backward(pixels)
        ctx.ranks = ranks
        ctx.shape = values.shape
        return values.reshape(-1, values.shape[-1]).index_select(0, pixels)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_output: Tensor) -> tuple[Tensor, None, None]:
        [pixels] = ctx.saved_tensors
        whole = grad_output.new_zeros(ctx.shape)
        if ctx.ranks:
            _add(whole.view(-1, ctx.shape[-1]), pixels, grad_output, ctx.ranks)
        else:  # each index occurs once, so copying suffices and no sums are needed
            whole.view(-1, ctx.shape[-1]).index_copy_(0, pixels, grad_output)
        return whole, None, None


def _add(image: Tensor, pixels: Tensor, values: Tensor, ranks: tuple[Tensor, ...]) -> None:
    """Adds values [P, C] to those of their pixels, rank by rank: in one order, whatever the device."""
    for rank in ranks:
        at = pixels[rank]
        image.index_copy_(0, at, image.index_select(0, at) + values.index_select(0, rank))


class _Image(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, radiance: Tensor, canvas: Canvas) -> Tensor:
        radiance = radiance.contiguous()
        ctx.canvas = canvas
        ctx.save_for_backward(radiance)
        image = canvas.empty.clone()
        if canvas.ranks:
            shown = to_display(radiance * canvas.base_color)
            _add(image, canvas.pixels, canvas.coverage * (shown - canvas.behind), canvas.ranks)
        elif compiled.runs(radiance):
            inputs = (canvas.base_color, canvas.coverage, canvas.under, canvas.pixels)
            compiled.call("composite", radiance.dtype, len(radiance), radiance, *inputs, image, compiled.threads())
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
            d_radiance = torch.empty_like(radiance)
            inputs = (canvas.base_color, canvas.coverage, canvas.pixels, grad_output, d_radiance)
            compiled.call("composite_backward", radiance.dtype, len(radiance), radiance, *inputs, compiled.threads())
            return d_radiance, None
        derivative = display_derivative(radiance * canvas.base_color) * canvas.base_color
        return grad_output.index_select(0, canvas.pixels) * canvas.coverage * derivative, None
