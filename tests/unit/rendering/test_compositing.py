"""Covered pixels in and out of images: against a loop over pixels, and by finite differences."""

import pytest
import torch
from torch import Tensor

from scene_attack.rendering.color import Canvas, over_ground, to_display
from scene_attack.rendering.kernels import compiled

SIZE = (7, 9)


def canvas(count: int = 37, dtype: torch.dtype = torch.float64, seed: int = 0) -> Canvas:
    """As many covered pixels, in no order, some of them half covered."""
    random = torch.Generator().manual_seed(seed)
    pixels = torch.randperm(SIZE[0] * SIZE[1], generator=random)[:count]
    base_color = torch.rand(count, 3, generator=random, dtype=torch.float64).to(dtype)
    coverage = (torch.randint(1, 17, (count, 1), generator=random) / 16).to(dtype)
    return Canvas(SIZE, pixels, base_color, coverage, torch.tensor([0.2, 0.5, 0.9], dtype=dtype))


def lit(count: int, dtype: torch.dtype = torch.float64) -> Tensor:
    """Radiance [P, 3] from black to far too bright."""
    return 3 * torch.rand(count, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64).to(dtype) ** 4


@pytest.mark.parametrize("count", [0, 1, 16, 37, 63])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.usefixtures("kernel")
def test_a_image_is_the_displayed_colour_over_the_ground(dtype: torch.dtype, count: int) -> None:
    of, radiance = canvas(count, dtype), lit(count, dtype)
    expected = of.ground.expand(*SIZE, 3).clone()
    for p, pixel in enumerate(of.pixels.tolist()):
        shown = to_display(radiance[p] * of.base_color[p])
        expected[divmod(pixel, SIZE[1])] = of.coverage[p] * shown + (1 - of.coverage[p]) * of.ground
    # one rounding more or less of the product and the sum, both at most 1
    close = 2 * torch.finfo(dtype).eps
    torch.testing.assert_close(of.image(radiance), expected, rtol=0, atol=close)


@pytest.mark.usefixtures("kernel")
def test_gradcheck_of_a_image() -> None:
    of = canvas()
    assert torch.autograd.gradcheck(of.image, lit(37).requires_grad_(), eps=1e-8)


def test_gradcheck_of_the_covered_pixels() -> None:
    values = torch.randn(*SIZE, 2, dtype=torch.float64).requires_grad_()
    of = canvas()
    assert torch.equal(of.covered(values), values.reshape(-1, 2)[of.pixels])
    assert torch.autograd.gradcheck(of.covered, values)


def test_the_two_kernels_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    of = canvas(dtype=torch.float32)
    found = []
    for library in (compiled.library, lambda: None):
        monkeypatch.setattr(compiled, "library", library)
        radiance = lit(37, torch.float32).requires_grad_()
        image = of.image(radiance)
        found.append((image.detach(), *torch.autograd.grad(image.square().sum(), radiance)))
    torch.testing.assert_close(*[image for image, _ in found], rtol=0, atol=3e-7)  # of displayed values up to 1
    torch.testing.assert_close(*[slope for _, slope in found], rtol=3e-6, atol=1e-6)
    assert found[0][1].any()


@pytest.mark.usefixtures("kernel")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_radiance_over_the_ground(dtype: torch.dtype) -> None:
    random = torch.Generator().manual_seed(3)
    coverage = (torch.randint(0, 5, (2, 5, 9, 1), generator=random) / 4).to(dtype)
    surface = 3 * torch.rand(2, 5, 9, 3, generator=random, dtype=torch.float64).to(dtype) ** 3
    ground = torch.tensor([0.2, 0.5, 0.9])
    shown = over_ground(torch.cat([surface * coverage, coverage], dim=-1), 0.5, ground)
    expected = coverage * to_display(0.5 * surface) + (1 - coverage) * ground.to(dtype)
    torch.testing.assert_close(shown, expected, rtol=0, atol=13 * 4 * torch.finfo(dtype).eps)  # 13: the curve's slope


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.usefixtures("kernel")
def test_surfaces_that_share_a_pixel_add_up(dtype: torch.dtype) -> None:
    """Pixels of one, two and three surfaces, whose parameters are those of the pixel."""
    pixels = torch.tensor([4, 11, 4, 20, 11, 4])
    shares = torch.tensor([0.5, 0.75, 0.25, 1.0, 0.25, 0.125], dtype=dtype)[:, None]
    ranks = tuple(torch.tensor(places) for places in ([0, 1, 3], [2, 4], [5]))
    plain = canvas(6, dtype)
    of = Canvas(SIZE, pixels, plain.base_color, shares, plain.ground, ranks)
    assert of.n_pixels == 3
    radiance = lit(6, dtype)
    shown = to_display(radiance * of.base_color)
    expected = of.ground.expand(SIZE[0] * SIZE[1], 3).clone()
    for pixel in (4, 11, 20):
        own = pixels == pixel
        expected[pixel] = (shares[own] * shown[own]).sum(0) + (1 - shares[own].sum()) * of.ground
    close = 8 * torch.finfo(dtype).eps
    torch.testing.assert_close(of.image(radiance), expected.reshape(*SIZE, 3), rtol=0, atol=close)
    values = torch.rand(*SIZE, 2, dtype=dtype, requires_grad=True)
    weights = torch.rand(6, 2, dtype=dtype)
    (of.covered(values) * weights).sum().backward()
    wanted = torch.zeros(SIZE[0] * SIZE[1], 2, dtype=dtype).index_add(0, pixels, weights)
    assert values.grad is not None
    torch.testing.assert_close(values.grad.reshape(-1, 2), wanted, rtol=0, atol=close)
    if dtype == torch.float64:
        assert torch.autograd.gradcheck(of.image, (0.1 + 0.2 * lit(6, dtype) / 3).requires_grad_())
