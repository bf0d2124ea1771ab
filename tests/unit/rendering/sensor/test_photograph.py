"""Each stage of a camera against a reference that is computed in another way: closed forms, SciPy and Pillow."""

from dataclasses import replace
from math import cos, log2, pi, radians, sin

import numpy as np
import pytest
import torch
from PIL import Image, ImageEnhance
from scipy.ndimage import shift
from torch import Tensor

from scene_attack.rendering.sensor.photograph import READ, WELL, photographed
from scene_attack.rendering.sensor.settings import GROUPS, PLAIN, SensorRange, of_shares


def picture(height: int = 24, width: int = 31) -> Tensor:
    random = torch.Generator().manual_seed(3)
    return torch.rand(1, height, width, 3, generator=random, dtype=torch.float64)


def linear(displayed: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, decoded."""
    return np.where(displayed <= 0.04045, displayed / 12.92, ((displayed + 0.055) / 1.055) ** 2.4)


def displayed(light: np.ndarray) -> np.ndarray:
    light = light.clip(0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def test_a_plain_camera_changes_no_bit() -> None:
    image = picture().float()
    assert torch.equal(photographed(image, PLAIN), image)


def test_exposure_and_white_balance_are_factors_of_linear_light() -> None:
    """A white that was overexposed is not brought back by the balance, which comes after the clipping."""
    image = picture()
    taken = photographed(image, replace(PLAIN, exposure=0.7, red=-0.4, blue=0.3))
    clipped = (linear(image.numpy()) * 2**0.7).clip(0, 1)
    expected = displayed(clipped * 2 ** np.array([-0.4, 0.0, 0.3]))
    np.testing.assert_allclose(taken.numpy(), expected, atol=1e-6)
    bright = photographed(torch.ones(1, 2, 2, 3, dtype=torch.float64), replace(PLAIN, exposure=2.0, red=-0.4))
    assert float(bright[0, 0, 0, 0]) == pytest.approx(float(displayed(np.array(2**-0.4))), abs=1e-6)


@pytest.mark.parametrize("radius", [0.3, 1.0, 2.5])
def test_a_point_out_of_focus_is_a_disc(radius: float) -> None:
    """Its second moment is that of a disc, r²/4 along an axis, plus that of the pixel's linear interpolation: a shift
    by x spreads a pixel over two, which adds the mean of f (1 − f), f being the fraction of x."""
    image = torch.zeros(1, 21, 21, 3, dtype=torch.float64)
    image[:, 10, 10] = 1.0
    light = linear(photographed(image, replace(PLAIN, defocus=radius)).numpy())[0, :, :, 1]
    at = np.arange(21) - 10
    across = np.linspace(-1, 1, 200_001) * radius
    density = np.sqrt(np.maximum(radius**2 - across**2, 0))
    fraction = across % 1
    spread = float((density * (across**2 + fraction * (1 - fraction))).sum() / density.sum())
    assert light.sum() == pytest.approx(1.0, abs=1e-5)
    for axis in (0, 1):
        along = light.sum(axis=axis)
        assert float(along @ at) == pytest.approx(0.0, abs=2e-3)
        assert float(along @ at**2) == pytest.approx(spread, rel=0.01)  # 1,024 points of the disc
    if radius > 2:  # the middle of the disc is even
        assert light[9:12, 9:12] == pytest.approx(1 / (pi * radius**2), rel=0.05)


def test_motion_is_the_mean_over_the_path() -> None:
    """Against SciPy's shift by linear interpolation, at many points of the path, of an image that ends in a border."""
    image = picture()
    image[:, :6], image[:, -6:], image[:, :, :6], image[:, :, -6:] = 0.2, 0.2, 0.2, 0.2
    taken = photographed(image, replace(PLAIN, motion=6.0, direction=-30.0))
    light, path = linear(image[0].numpy()), np.linspace(-0.5, 0.5, 401)
    shifted = [
        shift(light, (6 * t * sin(radians(-30)), 6 * t * cos(radians(-30)), 0), order=1, mode="nearest") for t in path
    ]
    np.testing.assert_allclose(taken[0].numpy(), displayed(np.mean(shifted, axis=0)), atol=2e-3)


@pytest.mark.parametrize(("level", "iso"), [(0.2, 400.0), (0.5, 3200.0), (0.1, 800.0)])
def test_noise_has_the_variance_of_photons_and_of_reading_out(level: float, iso: float) -> None:
    """Of 120,000 values; a variance has a relative standard error of √(2/n) = 0.4 %, and 5 of them are allowed. At
    half the exposure the same ISO has more noise relative to the light."""
    image = torch.tensor(displayed(np.full((1, 200, 200, 3), level)))
    light = linear(photographed(image, replace(PLAIN, iso=iso, exposure=-1.0), seed=7).numpy())
    electrons, white = level / 2 * WELL * 100 / iso, WELL * 100 / iso
    assert light.var() == pytest.approx((electrons + READ**2) / white**2, rel=0.02)
    assert light.mean() == pytest.approx(level / 2, rel=0.01)


def test_noise_is_the_same_for_all_images_of_a_batch_and_depends_on_the_seed() -> None:
    images = torch.full((2, 8, 8, 3), 0.5)
    first = photographed(images, replace(PLAIN, iso=1600.0), seed=4)
    assert torch.equal(first[0], first[1])
    assert torch.equal(first[:1], photographed(images[:1], replace(PLAIN, iso=1600.0), seed=4))
    assert not torch.equal(first, photographed(images, replace(PLAIN, iso=1600.0), seed=5))


@pytest.mark.parametrize("amount", [0.5, 2.0])
def test_sharpening_is_pillows(amount: float) -> None:
    """`ImageEnhance.Sharpness` by 1 + amount; Pillow smooths to whole numbers, an error of half of 1/255 times it."""
    image = (picture() * 255).round() / 255
    taken = photographed(image, replace(PLAIN, sharpening=amount))
    drawn = Image.fromarray((image[0] * 255).round().byte().numpy())
    expected = np.asarray(ImageEnhance.Sharpness(drawn).enhance(1 + amount)) / 255
    np.testing.assert_allclose(taken[0].numpy(), expected, atol=(0.51 * amount + 1) / 255)


def test_a_lower_resolution_is_pillows() -> None:
    """Pillow's bilinear filter is widened for the reduction, too; it rounds after each of its passes."""
    image = ((picture(40, 60) * 255).round() / 255).float()
    taken = photographed(image, replace(PLAIN, resolution=0.55))
    drawn = Image.fromarray((image[0] * 255).round().byte().numpy())
    small = drawn.resize((33, 22), Image.Resampling.BILINEAR)
    expected = np.asarray(small.resize((60, 40), Image.Resampling.BILINEAR)) / 255
    np.testing.assert_allclose(taken[0].numpy(), expected, atol=2.1 / 255)


def test_a_file_of_low_quality_loses_more() -> None:
    image = picture(64, 64).float()
    taken = [photographed(image, replace(PLAIN, quality=quality)) for quality in (95, 60, 10)]
    errors = [float((one - image).square().mean()) for one in taken]
    assert errors == sorted(errors)
    torch.testing.assert_close(taken[0], (taken[0] * 255).round() / 255)


def test_gradients_are_those_of_the_image() -> None:
    """Against float64 differences. A file of 8 bits is left out of them, and does not change the gradient."""
    image = (0.2 + 0.6 * picture(9, 8)).requires_grad_()
    sensor = replace(
        PLAIN, exposure=0.1, red=0.1, defocus=1.2, motion=1.5, direction=20.0, iso=400.0, sharpening=0.3, resolution=0.7
    )
    weights = torch.randn(image.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)

    def total(values: Tensor) -> Tensor:
        return (weights * photographed(values, sensor, seed=2)).sum()

    (gradient,) = torch.autograd.grad(total(image), image)
    for at in ((0, 0, 0, 0), (0, 4, 3, 1), (0, 8, 7, 2)):
        step = torch.zeros_like(image)
        step[at] = 1e-5
        difference = float((total(image + step) - total(image - step)).detach()) / 2e-5
        assert float(gradient[at]) == pytest.approx(difference, rel=1e-4, abs=1e-6)
    compressed = replace(PLAIN, quality=80)
    (through,) = torch.autograd.grad((weights * photographed(image, compressed)).sum(), image)
    torch.testing.assert_close(through, weights)


def test_the_image_of_a_batch_is_that_of_each_alone() -> None:
    images = torch.rand(3, 20, 30, 3, generator=torch.Generator().manual_seed(0))
    sensor = SensorRange().at([0.8] * 10)
    alone = torch.cat([photographed(image[None], sensor, seed=1) for image in images])
    assert torch.equal(photographed(images, sensor, seed=1), alone)


def test_a_range_is_filled_and_its_ends_are_the_settings() -> None:
    asked = SensorRange()
    low, high = asked.at([0.0] * 10), asked.at([1.0] * 10)
    assert (low.exposure, low.defocus, low.iso, low.resolution, low.quality) == (-0.5, 0.0, 100.0, 1.0, 100)
    assert (high.exposure, high.red, high.motion, high.direction) == (0.5, 0.2, 2.0, 180.0)
    assert (high.iso, high.resolution, high.quality) == (pytest.approx(1600), 0.75, 70)
    middle = asked.at([0.5] * 10)
    assert log2(middle.iso / 100) == pytest.approx(2.0)


def test_coordinates_are_shares_of_the_largest_change() -> None:
    def shares(value: float) -> dict[str, Tensor]:
        return {group: torch.full((len(settings),), value) for group, settings in GROUPS.items()}

    assert of_shares(shares(0.0)) == PLAIN
    strongest = of_shares(shares(1.0))
    assert (strongest.exposure, strongest.defocus, strongest.iso) == (1.0, 2.0, 3200.0)
    assert (strongest.resolution, strongest.quality) == (0.5, 30)
    assert of_shares(shares(0.008)).quality == 99  # 99.44, the nearest
    assert of_shares(shares(0.006)).quality == 100  # 99.58


def test_light_goes_on_beyond_the_edge_as_at_the_edge() -> None:
    """A ramp would be bent at its ends by a mirror, and dark there by nothing."""
    image = picture()
    taken = photographed(image, replace(PLAIN, motion=6.0))
    light, path = linear(image[0].numpy()), (np.arange(1024) + 0.5) / 1024 - 0.5
    shifted = [shift(light, (0, 6 * t, 0), order=1, mode="nearest") for t in path]
    np.testing.assert_allclose(taken[0].numpy(), displayed(np.mean(shifted, axis=0)), atol=1e-4)
