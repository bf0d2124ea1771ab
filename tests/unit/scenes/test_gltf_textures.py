"""Textures of glTF files in formats that Pillow does not convert by itself."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from tests.unit.scenes.test_gltf import one, read, texture_of


@pytest.mark.parametrize(("grey", "kind"), [(20_000, np.uint16), (78, np.uint8)])
def test_a_grey_texture_keeps_its_grey(grey: int, kind: type[np.generic]) -> None:
    """Pillow clips it to white: 20,000 of 65,535 is grey 78 of 255."""
    stored = BytesIO()
    Image.fromarray(np.full((4, 4), grey, kind)).save(stored, "PNG")
    writer = one({}, texture_of(stored.getvalue()), TEXCOORD_0=[[0, 0]] * 3)
    [part] = read(writer)
    assert part.metallic_roughness is not None
    [texture] = part.metallic_roughness.maps.values()
    assert (texture.texels == (78, 78, 78, 255)).all()
