"""Environment maps as files, read back."""

import numpy as np
import OpenEXR
import pytest

from services.export.parameters import equirectangular, write_exr
from services.scenes.environment import average, from_image, read_exr


@pytest.mark.parametrize(("rows", "cols"), [(1, 4), (8, 16), (5, 6), (3, 7)])
def test_a_map_comes_back_with_every_bit(tmp_path, rows: int, cols: int) -> None:
    radiance = np.random.default_rng(0).gamma(0.5, 9, (rows, cols, 3)).astype(np.float32)
    write_exr(radiance, tmp_path / "map.exr", "a map")
    read = read_exr(tmp_path / "map.exr", None).radiance
    wide = read.shape[1] // cols
    assert wide == (1 if cols % 4 == 0 else 4)
    assert np.array_equal(read[:, ::wide], radiance)
    assert np.allclose(average(read, rows, cols), radiance, rtol=1e-6)


def test_the_middle_column_of_the_image_is_plus_x_and_plus_z_is_to_its_right() -> None:
    """Column j of a map looks along the azimuth (j + 1/2) 2 pi / cols, from +z towards +x."""
    radiance = np.zeros((1, 8, 3), np.float32)
    radiance[0, 2], radiance[0, 0] = 1, 2  # just after +x; just after +z
    image = equirectangular(radiance)[0, :, 0]
    assert list(image.nonzero()[0]) == [3, 5]
    assert (image[3], image[5]) == (1, 2)
    assert np.array_equal(from_image(equirectangular(radiance)), radiance)


def test_the_file_says_what_its_numbers_are(tmp_path) -> None:
    write_exr(np.ones((2, 4, 3), np.float32), tmp_path / "map.exr", "radiance of a test")
    with OpenEXR.File(str(tmp_path / "map.exr")) as file:
        assert file.header()["comments"] == "radiance of a test"
        assert file.channels()["RGB"].pixels.dtype == np.float32
