import numpy as np
import torch

from scene_attack_questions.clevr.records import ATTRIBUTES
from training.iep.examples import ObjectTruth
from training.iep.trunk_training import AugmentedViews


def test_the_objects_of_a_changed_view_are_where_their_pixels_are() -> None:
    """Each image has a bright square of its own where its only object is."""
    attributes = {name: values[0] for name, values in ATTRIBUTES.items()}
    random = np.random.default_rng(0)
    places = [(int(row), int(column)) for row, column in random.integers((20, 20), (220, 300), (12, 2))]
    images = np.full((12, 240, 320, 3), 60, np.uint8)
    for image, (row, column) in zip(images, places, strict=True):
        image[row - 4 : row + 4, column - 4 : column + 4] = 180
    objects = [[ObjectTruth(row, column, attributes)] for row, column in places]
    views = AugmentedViews(lambda chosen: images[np.asarray(chosen)], objects)
    chosen = np.arange(12)
    shown, found = views(chosen, np.random.default_rng(3))
    assert shown.dtype == torch.float32
    assert 0 <= float(shown.min()) < float(shown.max()) <= 1
    turned = 0
    for image, (one,), (row, column) in zip(shown, found, places, strict=True):
        bright = (image.mean(2) > 0.5).nonzero().double().mean(0) + 0.5
        assert torch.allclose(bright, torch.tensor([one.row, one.column], dtype=torch.float64), atol=0.1)
        assert one.row == row
        turned += one.column != column
    assert 2 <= turned <= 10
    means = shown.mean((1, 2))
    assert float(means.std(0).min()) > 0.01
    assert float((means - means.mean(1, keepdim=True)).abs().max()) > 0.003
    again, _ = views(chosen, np.random.default_rng(3))
    assert torch.equal(shown, again)
