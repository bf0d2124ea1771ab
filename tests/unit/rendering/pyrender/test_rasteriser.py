"""What the rasteriser guarantees by itself: no gaps along edges, any number of threads, the faces that it shades."""

import numpy as np
import pytest
import torch

from tests.unit.rendering.pyrender.rasterised_scenes import GLASS, moved, rasterised, sample_grid, soup, wrinkled
from tests.unit.rendering.shapes import mesh, placed, quad, scene

pytestmark = pytest.mark.usefixtures("software_opengl")


def test_edges_through_samples_belong_to_one_face() -> None:
    """The vertices lie on the grid of samples, in an image whose pixels are 1/32 apart at the origin's depth. So every
    edge runs through samples, and every face has a neighbour there."""
    renderer = rasterised(placed(scene((64, 64), distance=2.0, field_of_view=2 * np.arctan(0.5)), mesh(sample_grid())))
    assert renderer.radiance({})[0, 25:39, 25:39, 3].min() == 1


def test_images_are_bit_identical_for_any_number_of_threads() -> None:
    renderer = rasterised(placed(scene((96, 128)), mesh(wrinkled(0, 40), soup(1, 99, 0.2, GLASS))))
    parameters, before = moved(renderer, 0), torch.get_num_threads()
    try:
        drawn = []
        for count in (1, 2, 5):
            torch.set_num_threads(count)
            drawn.append(renderer.radiance(parameters))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(drawn[0], drawn[1])
    assert torch.equal(drawn[0], drawn[2])


def test_the_plan_counts_the_faces_that_are_shaded() -> None:
    """There are nine squares. One is behind another, and one is too small to cover a sample."""
    squares = [quad(0.05, centre=(x, y, 0)) for x in (-0.3, 0, 0.3) for y in (-0.3, 0, 0.3)]
    squares[0] = quad(0.05, centre=(0, 0, -0.4))
    squares[1] = quad(1e-5, centre=(-0.3, 0.01, 0))
    renderer = rasterised(placed(scene((96, 128)), mesh(*squares)))
    [item] = [item for item in renderer.plan.items if item.what == "faces shaded"]
    assert (item.kept, item.of) == (14, 18)
    [exact] = [item for item in renderer.exact().plan.items if item.what == "faces shaded"]
    assert exact.kept == exact.of == 18
