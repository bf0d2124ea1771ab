"""The thumbnails of uploads: a mesh as the pyrender renderer shows it, and an environment map as it is."""

import io

import numpy as np
from PIL import Image

from scene_attack.runs.spec import JobSpec, parse
from scene_attack.scenes.environment import EnvironmentMap, average
from scene_attack.scenes.mesh import Bytes

SIDE = 192
"""Height and width of a mesh's thumbnail, pixels; a map's is half as high."""


def thumbnail_spec(name: str) -> JobSpec:
    """Returns the request whose scene is an uploaded mesh alone, from the default camera in the default light."""
    scene = {"camera": {"size": (SIDE, SIDE)}, "objects": [{"mesh": name}]}
    return parse({"scene": scene, "attack": {"renderer": "pyrender"}})


def picture_of(light: EnvironmentMap) -> bytes:
    """Returns an environment map as a PNG file: its mean displayed at half of white, highlights compressed.

    It is turned as in a file: its middle is +x, and columns further right show +z.
    """
    radiance = average(light.radiance, SIDE // 2, SIDE)
    relative = radiance / max(float(radiance.mean()), 1e-12) * 0.5
    shown = (relative / (1 + relative)) ** (1 / 2.2)
    pixels: Bytes = np.rint(255 * np.roll(shown, SIDE // 4, axis=1)[:, ::-1]).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()
