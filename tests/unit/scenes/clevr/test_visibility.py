"""The closed-form image of object numbers against the G-buffer that OpenGL draws of the scene's description."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from services.rendering.opengl.gbuffer import rasterise
from services.scenes.clevr.description import describe
from services.scenes.clevr.generator import MIN_PIXELS, Placed, generate, object_numbers, placed_in, visible_pixels
from services.scenes.clevr.records import Rig
from services.scenes.primitives import primitive
from tests.unit.rendering.shapes import placed


@pytest.mark.parametrize("index", range(4))
def test_the_image_is_that_of_the_g_buffer_but_for_silhouettes(index: int) -> None:
    scene = generate(3, index)
    description = describe(scene)
    buffer = rasterise(placed(description, *(primitive(o.mesh.split("/")[1]) for o in description.objects)))
    drawn = np.where(buffer.coverage.numpy() >= 0.5, buffer.object_index.numpy(), -1)
    drawn[drawn >= len(scene.objects)] = -1  # a floor is no object
    numbers = object_numbers(placed_in(scene), scene.rig)
    silhouettes = np.zeros(numbers.shape, bool)
    for k in (-1, *range(len(scene.objects))):
        silhouettes |= binary_dilation(numbers == k) & (numbers != k)
    different = numbers != drawn
    assert not (different & ~silhouettes).any()
    # A polygon lies within its circle, and a pixel's centre is not all of it: under a tenth of the silhouettes' pixels.
    assert different.sum() < 0.1 * silhouettes.sum()


def test_generated_objects_are_seen_in_enough_pixels() -> None:
    for index in range(40):
        scene = generate(4, index)
        assert min(visible_pixels(placed_in(scene), scene.rig)) >= MIN_PIXELS


def test_an_object_behind_another_is_hidden_by_it() -> None:
    rig = Rig()
    near = Placed("sphere", "large", "red", "metal", (0.0, 0.0, 0.7), 0.0)
    # The centre of the second lies on the ray from the eye through the first's.
    far = Placed("sphere", "small", "blue", "metal", (-1.5 * 7.4811, 1.5 * 6.5076, 0.7 - 1.5 * 4.6437), 0.0)
    alone, hidden = visible_pixels([far], rig), visible_pixels([near, far], rig)
    assert alone[0] > 50
    assert hidden[1] == 0
    assert visible_pixels([far, near], rig) == hidden[::-1]
