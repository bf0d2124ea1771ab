import numpy as np
import torch

from services.rendering.display import to_display, to_linear


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
    np.testing.assert_allclose(to_linear(shown).numpy(), linear, atol=1e-5)
    np.testing.assert_allclose(to_display(torch.tensor([-1.0, 2.0])), [0.0, 1.0], atol=1e-7)
