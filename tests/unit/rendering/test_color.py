import numpy as np
import pytest
import torch

from scene_attack.rendering.color import display_derivative, from_bytes, quantize, to_bytes, to_display
from scene_attack.scenes.image_file import to_linear

pytestmark = pytest.mark.usefixtures("kernel")


def test_a_values_bits_do_not_depend_on_where_it_stands() -> None:
    """torch's power in float32 takes another way at the end of a tensor, and failed this."""
    values = torch.rand(5003, generator=torch.Generator().manual_seed(0))
    whole = to_display(values)
    for size in (1, 3, 7, 100):
        assert torch.equal(torch.cat([to_display(some) for some in values.split(size)]), whole)


def test_the_curve_is_that_of_the_standard() -> None:
    linear = np.linspace(0, 1, 2001)
    expected = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    shown = to_display(torch.from_numpy(linear))
    np.testing.assert_allclose(shown.numpy(), expected, atol=1e-15)
    # float32: a few units in the last place at 1
    np.testing.assert_allclose(to_display(torch.from_numpy(linear).float()).numpy(), expected, atol=3e-7)
    # the standard's two constants meet to about 1e-5
    np.testing.assert_allclose(to_linear(shown.numpy()), linear, atol=1e-5)


def test_what_is_out_of_range_is_clipped_and_what_is_no_number_stays_none() -> None:
    values = torch.tensor([-torch.inf, -1.0, 0.0, 1.0, 2.0, torch.inf, torch.nan])
    for dtype in (torch.float32, torch.float64):
        shown = to_display(values.to(dtype))
        torch.testing.assert_close(shown, values.to(dtype).clamp(0, 1), rtol=0, atol=1e-6, equal_nan=True)


def test_the_slope_is_that_of_the_curve_and_zero_where_it_is_clipped() -> None:
    linear = (
        torch.cat([torch.linspace(-0.51, 1.52, 100), torch.tensor([1e-6, 0.003, 0.0032])]).double().requires_grad_()
    )
    assert torch.autograd.gradcheck(to_display, linear, eps=1e-7)
    outside = torch.tensor([-1e-3, 1.001])
    assert not display_derivative(outside).any()


def test_saving_rounds_to_nearest_and_ties_to_even() -> None:
    """The middles between bytes among the values, and what is out of range."""
    middles = (torch.arange(255) + 0.5) / 255
    values = torch.cat(
        [middles, torch.rand(4099, generator=torch.Generator().manual_seed(0)), torch.tensor([-1.0, 2.0])]
    )
    images, seen = quantize(values)
    assert torch.equal(images, to_bytes(values))
    assert torch.equal(seen, from_bytes(images))
    rounded = np.rint(np.clip(values.numpy(), 0, 1) * np.float32(255))
    np.testing.assert_array_equal(images.numpy(), rounded)
    assert images[-2:].tolist() == [0, 255]
