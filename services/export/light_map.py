"""Writes an environment map as an OpenEXR image, as other programs read it."""

from pathlib import Path

import numpy as np
import OpenEXR

from services.scenes.mesh import Floats


def equirectangular(radiance: Floats) -> Floats:
    """A map [rows, cols, 3] in this project's directions as an equirectangular image; `environment.from_image` inverts.

    The image shows the sphere from inside: its middle column is +x, and columns further right show +z. So that its
    texels are the map's, each column is repeated four times where the number of columns is no multiple of four.
    """
    columns = radiance if radiance.shape[1] % 4 == 0 else np.repeat(radiance, 4, axis=1)
    return np.ascontiguousarray(np.roll(columns, columns.shape[1] // 4, axis=1)[:, ::-1])


def write_exr(radiance: Floats, path: Path, comment: str) -> None:
    """Writes linear RGB radiance float32 [rows, cols, 3], in this project's directions, with 32 bits a value."""
    image = np.asarray(equirectangular(radiance), np.float32)
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "comments": comment}
    channels = {name: np.ascontiguousarray(image[..., k]) for k, name in enumerate("RGB")}
    with OpenEXR.File(head, channels) as file:
        file.write(str(path))
