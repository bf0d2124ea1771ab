import math

import pytest
import torch

from scene_attack.analysis.images import FULL_RANGE, beyond, of_float_images, of_groups, of_images, perceptibility
from scene_attack.rendering.color import to_bytes


def test_a_constant_change_by_hand() -> None:
    # every pixel moves by (3, 4, 0)/255: p is exactly 5/255
    original = torch.zeros(6, 7, 3, dtype=torch.uint8)
    attacked = original + torch.tensor([3, 4, 0], dtype=torch.uint8)
    assert of_images(original, attacked) == pytest.approx(5 / 255, rel=1e-12)
    assert of_images(attacked, original) == pytest.approx(5 / 255, rel=1e-12)  # uint8 must not wrap


def test_one_pixel_of_many() -> None:
    change = torch.zeros(10, 10, 3)
    change[4, 2] = 1.0
    # mean over 100 pixels of a squared norm of 3; a mean over channels too would lose a factor √3
    assert perceptibility(change) == pytest.approx(math.sqrt(3 / 100), rel=1e-12)


def test_groups_take_the_mean_over_their_places() -> None:
    ones = {"normals": torch.ones(5, 5, 2), "illumination": torch.ones(4, 8), "material": torch.ones(1, 3, 3, 2, 6)}
    p = of_groups("torch", ones)
    assert p == pytest.approx({"normals": math.sqrt(2), "illumination": 1.0, "material": math.sqrt(12)})
    assert of_groups("pyrender", {"illumination": torch.ones(5)}) == pytest.approx({"illumination": math.sqrt(5)})


def test_beyond_counts_pixels_not_channels() -> None:
    original = torch.full((2, 2, 3), 100, dtype=torch.uint8)
    attacked = original.clone()
    attacked[0, 0] = torch.tensor([119, 119, 100])
    attacked[1, 1] = torch.tensor([118, 82, 100])  # exactly at the limit, both ways
    assert beyond(original, attacked, 18) == 1


def test_black_against_white_is_the_full_range() -> None:
    black, white = torch.zeros(4, 5, 3), torch.ones(4, 5, 3)
    assert of_float_images(black, white) == pytest.approx(FULL_RANGE, rel=1e-15)
    assert of_images(black.byte(), 255 * white.byte()) == pytest.approx(FULL_RANGE, rel=1e-12)
    assert pytest.approx(3, rel=1e-15) == FULL_RANGE**2


def test_a_step_below_half_an_8_bit_step_is_lost_and_one_above_it_doubles() -> None:
    """A step of 0.002 is 0.51/255: every value is saved one step of 1/255 further, at 1/(255 · 0.002) times the p."""
    original = torch.full((6, 6, 3), 128 / 255, dtype=torch.float64)
    for step, saved in ((0.002, math.sqrt(3) / 255), (0.0019, 0.0)):
        attacked = original + step
        assert of_float_images(original, attacked) == pytest.approx(math.sqrt(3) * step, rel=1e-12)
        assert of_images(to_bytes(original), to_bytes(attacked)) == pytest.approx(saved, rel=1e-12)
