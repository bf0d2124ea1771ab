"""The image that a camera takes of a displayed image, from the lens to the file.

A displayed image is decoded to linear light (sRGB), and what follows happens in the order of a real camera:

1. defocus: a point of light is spread evenly over a disc, and motion: over the path of the image during the exposure.
   Both are means of the image shifted by points of the disc or the path, interpolated linearly, so that a small disc
   has a small effect; beyond its edge the image goes on as at the edge;
2. exposure: all light is multiplied;
3. noise: of light x, in [0,1], the variance is x / N + (R / N)², that of N x photons and of reading them out (the
   linear model of EMVA 1288), where N is `WELL` electrons at ISO 100 and falls with the ISO, and R is `READ`;
4. what is brighter than white is clipped, the channels are balanced, and clipped again; the sRGB curve is applied;
5. sharpening: what distinguishes a pixel from the mean of its neighbours is exaggerated;
6. resolution: the image is made smaller and enlarged again;
7. a JPEG file, written and read by Pillow with its defaults.

A stage whose setting changes nothing is left out. Light that the displayed image has clipped is lost: no exposure
brings it back. There is no mosaic of colour filters.
"""

from io import BytesIO
from math import ceil, cos, radians, sin

import torch
from PIL import Image
from torch import Tensor
from torch.nn import functional

from scene_attack.rendering.color import from_bytes, to_bytes, to_display
from scene_attack.rendering.sensor.settings import BASE_ISO, LOSSLESS, Sensor

WELL = 10_000.0
"""Electrons of a white pixel at ISO 100: that of a pixel of about 2 µm, as small cameras have."""
READ = 3.0
"""Standard deviation of reading a pixel out, electrons."""
POINTS = 1024
"""Points of the disc, and of the path, whose shifts are averaged."""
GOLDEN_ANGLE = 2.399963229728653
"""Radians between successive points of the disc, which cover it evenly (Vogel 1979)."""


def photographed(images: Tensor, sensor: Sensor, seed: int = 0) -> Tensor:
    """The images [B, H, W, 3] in [0,1] as the camera takes them, of the same shape and range.

    The noise depends on the seed and the image's size alone, and is the same for all images. It is differentiable in
    the images; through the rounding of a JPEG file the derivative is that of the image itself.
    """
    if any((sensor.exposure, sensor.red, sensor.blue, sensor.defocus, sensor.motion, sensor.iso)):
        images = to_display(_sensed(_from_display(images).permute(0, 3, 1, 2), sensor, seed).permute(0, 2, 3, 1))
    if sensor.sharpening:
        images = _sharpened(images, sensor.sharpening)
    if sensor.resolution != 1:
        images = _resized(images, sensor.resolution)
    return images if sensor.quality == LOSSLESS else images + (_through_jpeg(images, sensor.quality) - images).detach()


def _from_display(images: Tensor) -> Tensor:
    """Linear light of displayed values in [0,1]: the inverse of `to_display`."""
    curved = 2.4 * ((images.clamp_min(0.04045) + 0.055) / 1.055).log()
    return torch.where(images <= 0.04045, images / 12.92, curved.exp())


def _sensed(light: Tensor, sensor: Sensor, seed: int) -> Tensor:
    """Linear light [B, 3, H, W], balanced, after lens, exposure and noise."""
    if sensor.defocus:
        light = _spread(light, sensor.defocus * _disc())
    if sensor.motion:
        along = sensor.motion * ((torch.arange(POINTS, dtype=torch.float64) + 0.5) / POINTS - 0.5)
        angle = radians(sensor.direction)
        light = _spread(light, torch.stack((cos(angle) * along, sin(angle) * along), dim=1))
    light = light * 2**sensor.exposure
    if sensor.iso:
        white = WELL * BASE_ISO / sensor.iso
        deviation = (light.clamp_min(0) / white + (READ / white) ** 2).sqrt()
        random = torch.Generator().manual_seed(seed)
        noise = torch.randn(light.shape[1:], generator=random, dtype=torch.float64)
        light = light + deviation * noise.to(light)
    balance = light.new_tensor([2**sensor.red, 1.0, 2**sensor.blue])
    return (light.clamp(0, 1) * balance[:, None, None]).clamp(0, 1)


def _disc() -> Tensor:
    """Points [POINTS, 2] that cover the disc of radius 1 evenly, about its centre."""
    number = torch.arange(POINTS, dtype=torch.float64)
    radius, angle = ((number + 0.5) / POINTS).sqrt(), GOLDEN_ANGLE * number
    points = radius[:, None] * torch.stack((angle.cos(), angle.sin()), dim=1)
    return points - points.mean(dim=0)


def _spread(light: Tensor, points: Tensor) -> Tensor:
    """The mean of light [B, 3, H, W] shifted by points [n, 2], right and down in pixels, interpolated linearly."""
    reach = ceil(float(points.abs().max())) + 1
    grid = torch.arange(-reach, reach + 1, dtype=torch.float64)
    across, down = ((1 - (grid - points[:, axis : axis + 1]).abs()).clamp_min(0) for axis in (0, 1))
    kernel = (down.T @ across / len(points)).to(light)
    padded = functional.pad(light, (reach,) * 4, mode="replicate")
    # one channel at a time: the same sums whatever the batch
    return functional.conv2d(padded.flatten(0, 1)[:, None], kernel.flip(0, 1)[None, None]).reshape(light.shape)


def _sharpened(images: Tensor, amount: float) -> Tensor:
    """Images [B, H, W, 3] plus `amount` times their difference from a smoothed copy; the outermost pixels stay.

    The smoothed pixel is 5/13 of itself and 1/13 of each of its 8 neighbours, as Pillow's `ImageFilter.SMOOTH` has it.
    """
    values = images.permute(0, 3, 1, 2).flatten(0, 1)[:, None]
    kernel = values.new_full((1, 1, 3, 3), 1 / 13)
    kernel[0, 0, 1, 1] = 5 / 13
    inside = values[:, :, 1:-1, 1:-1]
    edges = functional.pad(inside - functional.conv2d(values, kernel), (1, 1, 1, 1))
    sharp = (values + amount * edges).clamp(0, 1)
    return sharp.reshape(len(images), 3, *images.shape[1:3]).permute(0, 2, 3, 1)


def _resized(images: Tensor, factor: float) -> Tensor:
    """Images [B, H, W, 3] at `factor` times their height and width, rounded to whole pixels, and enlarged again."""
    size = images.shape[1:3]
    small = [max(1, round(factor * side)) for side in size]
    channels = images.permute(0, 3, 1, 2)
    reduced = functional.interpolate(channels, small, mode="bilinear", antialias=True)
    enlarged = functional.interpolate(reduced, tuple(size), mode="bilinear")
    return enlarged.permute(0, 2, 3, 1).clamp(0, 1)


def _through_jpeg(images: Tensor, quality: int) -> Tensor:
    """Images [B, H, W, 3], rounded to 8 bits, after they were written as JPEG files and read again."""
    read = []
    for image in to_bytes(images).cpu():
        file = BytesIO()
        Image.fromarray(image.numpy()).save(file, format="JPEG", quality=quality)
        with Image.open(file) as written:
            pixels = bytearray(written.convert("RGB").tobytes())
        read.append(torch.frombuffer(pixels, dtype=torch.uint8).reshape(image.shape))
    return from_bytes(torch.stack(read)).to(images)
