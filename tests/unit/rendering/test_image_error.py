"""The two numbers of an image's error, what a tolerance allows, and what a plan estimates from them."""

import pytest
import torch

from scene_attack.rendering.plan import ImageError, image_error
from scene_attack.rendering.pyrender.planner import estimated


def test_the_mean_is_over_covered_pixels_and_the_share_counts_those_off_by_more_than_a_step() -> None:
    ground = torch.tensor([0.5, 0.5, 0.5])
    exact = ground.expand(10, 10, 3).clone()
    exact[:4] = 0.25  # 40 covered pixels
    image = exact.clone()
    image[0, 0, 1] += 0.3
    image[1, 5] += 0.9 / 255
    image[2, 7, 2] -= 1.1 / 255
    error, covered = image_error(image, exact, ground)
    assert covered == 40
    assert error.mean == pytest.approx((0.3 + 3 * 0.9 / 255 + 1.1 / 255) / 3 / 40, rel=1e-5)
    assert error.share == 2 / 40


@pytest.mark.parametrize(
    ("error", "allowed"),
    [
        (ImageError(0.99e-3, 0.99e-2), True),
        (ImageError(1.01e-3, 0.0), False),
        (ImageError(0.0, 1.01e-2), False),
    ],
)
def test_a_tolerance_allows_its_mean_and_ten_times_its_share(error: ImageError, allowed: bool) -> None:
    assert error.within(1e-3) is allowed


def test_the_worse_of_two_errors_has_the_larger_of_each_number() -> None:
    assert ImageError(1e-3, 0.2).or_worse(ImageError(2e-3, 0.1)) == ImageError(2e-3, 0.2)
    assert ImageError(1e-3, 0.2).or_worse(None) == ImageError(1e-3, 0.2)


def test_the_estimate_is_twice_what_was_measured_four_pixels_and_a_line() -> None:
    """Of 100 and of 1,600 pixels. At a silhouette one of four samples changes a pixel by a quarter at most. A face seen
    from its edge is a line, half as long as the side of a square of as many pixels."""
    for covered, line in ((100, 5), (1600, 20), (36, 4)):
        found = estimated(ImageError(1e-4, 2e-3), covered)
        assert (found.mean, found.share) == pytest.approx((2e-4 + 4 / covered / 4, 4e-3 + line / covered))
