"""What the group `lamp` adds to a map, by its definition, in numpy: turned by interpolation between texels, and a lobe
whose texels are summed one by one."""

from math import cos, log, pi, radians, sin

import numpy as np
import torch

from scene_attack.rendering.torch.lamp import physical, tint


def added(
    chroma: np.ndarray, own: np.ndarray, intensity: np.ndarray, solid: np.ndarray, values: np.ndarray
) -> np.ndarray:
    """What is added [rows, cols, 3] to the `intensity` [rows, cols] of a map that had its `own`, by colour channel."""
    light = physical(torch.from_numpy(values).double())
    # The colours of black bodies are tested by themselves, against Planck's law.
    factor = float(light.brightness) * tint(light.temperature).numpy()
    rows, cols = own.shape
    radiance = chroma * own[..., None]
    brighter = (intensity * solid).sum() / (own * solid).sum()
    azimuth, elevation = radians(float(light.azimuth)), radians(float(light.elevation))
    middle = [cos(elevation) * sin(azimuth), sin(elevation), cos(elevation) * cos(azimuth)]
    sharpness = log(2) / (1 - cos(radians(float(light.radius))))
    lobe, turned = np.empty((rows, cols)), np.empty_like(radiance)
    for i in range(rows):
        for j in range(cols):
            theta, phi = (i + 0.5) * pi / rows, (j + 0.5) * 2 * pi / cols
            towards = np.array([sin(theta) * sin(phi), cos(theta), sin(theta) * cos(phi)])
            lobe[i, j] = np.exp(sharpness * (towards @ middle - 1))
            place = j - float(light.turn) / 360 * cols
            left = int(np.floor(place))
            turned[i, j] = (left + 1 - place) * radiance[i, left % cols]
            turned[i, j] += (place - left) * radiance[i, (left + 1) % cols]
    lamp = float(light.power) * (intensity * solid).sum() * lobe / (lobe * solid).sum()
    wanted = factor * (chroma * intensity[..., None] + brighter * (turned - radiance)) + lamp[..., None]
    return wanted / chroma - intensity[..., None]
