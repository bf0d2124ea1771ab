import numpy as np
import torch

from training import batches
from training.batches import distort


def _disc(side: int = 64) -> torch.Tensor:
    at = torch.linspace(-1, 1, side)
    inside = (at[:, None] ** 2 + at[None] ** 2 < 0.25).float()
    return (0.25 + 0.5 * inside).expand(1, 3, side, side).contiguous()


def test_areas_and_places_stay_in_their_ranges(monkeypatch):
    """A disc becomes an ellipse; its area is that of the size alone, within what the shear and the grid change."""
    monkeypatch.setattr(batches, "ERASED", 0.0)
    image = _disc()
    inside = image > 0.5
    areas, places = [], []
    for seed in range(40):
        found = distort(image, np.random.default_rng(seed))[0, 0] > 0.5
        areas.append(float(found.sum() / inside[0, 0].sum()))
        places.append(found.nonzero().double().mean(0) / 32 - 31.5 / 32)
    assert batches.SMALLEST**2 * 0.95 < min(areas) < 0.7
    assert 1.0 < max(areas) < batches.LARGEST**2 * 1.05
    furthest = torch.stack(places).abs().amax(0)
    assert float(furthest.max()) < 1.6 * batches.SHIFT
    assert float(furthest.min()) > 0.5 * batches.SHIFT


def test_outside_is_the_ground_and_a_seed_gives_the_same_image(monkeypatch):
    monkeypatch.setattr(batches, "ERASED", 0.0)
    found = distort(_disc(), np.random.default_rng(1))
    assert abs(float(found.min()) - 0.25) < 1e-6
    assert torch.equal(found, distort(_disc(), np.random.default_rng(1)))


def test_strength_scales_the_ranges(monkeypatch):
    monkeypatch.setattr(batches, "ERASED", 0.0)
    image = _disc()
    assert torch.allclose(distort(image, np.random.default_rng(3), 0.0), image, atol=1e-5)
    areas = [
        float((distort(image, np.random.default_rng(seed), 1 / 3) > 0.5).sum() / (image > 0.5).sum())
        for seed in range(40)
    ]
    assert batches.SMALLEST ** (2 / 3) * 0.95 < min(areas) < 0.9
    assert 1.0 < max(areas) < batches.LARGEST ** (2 / 3) * 1.05


def test_some_images_are_partly_hidden():
    images = torch.full((200, 3, 32, 32), 0.5)
    found = distort(images, np.random.default_rng(0))
    share = float(((found - 0.5).abs() > 1e-3).flatten(1).any(1).double().mean())
    assert abs(share - batches.ERASED) < 0.1
