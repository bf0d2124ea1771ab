import numpy as np
import pytest
import torch

from scene_attack.rendering.pyrender.renderer import PyrenderRenderer
from scene_attack.scenes.description import GROUND
from tests.unit.rendering.shapes import mesh, placed, quad, scene, six_parts, sphere


def test_a_square_has_the_rectangle_of_its_projection() -> None:
    renderer = PyrenderRenderer(placed(scene((101, 151)), mesh(quad(0.1, 0.2, centre=(0.2, 0.1, 0)))))
    top, bottom, left, right = renderer.extent(renderer.initial())
    scale = 101 / 2 / (1.8 * np.tan(0.8575 / 2))  # pixels to a scene unit at distance 1.8
    expected = [50.5 - 0.3 * scale, 50.5 + 0.1 * scale, 75.5 + 0.1 * scale, 75.5 + 0.3 * scale]
    # whole pixels outward, and one more
    np.testing.assert_allclose([top + 1, bottom - 1, left + 1, right - 1], expected, atol=1)


def test_nothing_is_drawn_outside_the_rectangle() -> None:
    renderer = PyrenderRenderer(placed(scene((60, 90), azimuth=0.5, elevation=0.4), six_parts()))
    generator = torch.Generator().manual_seed(0)
    batch = {
        "rotation": 2 * torch.randn((8, 1, 3), generator=generator, dtype=torch.float64),
        "translation": 0.05 * torch.randn((8, 1, 3), generator=generator, dtype=torch.float64),
    }
    whole = renderer.exact().render(batch)
    assert torch.equal(renderer.render(batch), whole)
    for row in range(8):
        top, bottom, left, right = renderer.extent({group: value[row] for group, value in batch.items()})
        drawn = (whole[row] != GROUND).any(-1).nonzero()
        assert drawn[:, 0].min() >= top
        assert drawn[:, 0].max() < bottom
        assert drawn[:, 1].min() >= left
        assert drawn[:, 1].max() < right
        # and it is no larger than it must be: within three pixels of what is drawn
        found = [drawn[:, 0].min(), drawn[:, 0].max() + 1, drawn[:, 1].min(), drawn[:, 1].max() + 1]
        np.testing.assert_allclose([top, bottom, left, right], found, atol=3)


@pytest.mark.parametrize("to", [(0.0, 0.0, 1.7), (0.0, 0.0, 2.5), (0.0, 0.0, 1.3)])
def test_an_object_that_reaches_behind_the_camera_has_the_whole_image(to: tuple[float, ...]) -> None:
    renderer = PyrenderRenderer(placed(scene((24, 32)), mesh(sphere(0.6, 12))))
    moved = {"translation": torch.tensor([[to]], dtype=torch.float64)}
    assert renderer.extent({"translation": moved["translation"][0]}) == (0, 24, 0, 32)
    assert torch.equal(renderer.render(moved), renderer.exact().render(moved))
