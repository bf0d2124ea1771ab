import pytest
import torch

from training.export import Images, clustered_error, confusion, measured
from training.split import committed


def test_errors_are_those_of_the_models_means():
    """With as many views of each model, the clustered error is the standard error of the models' means."""
    random = torch.Generator().manual_seed(0)
    right = torch.rand(12, 5, generator=random) < torch.rand(12, 1, generator=random)
    means = right.double().mean(1)
    models = torch.arange(12).repeat_interleave(5)
    assert clustered_error(right.flatten(), models) == pytest.approx(float(means.std() / 12**0.5))
    alike = right[:, :1].expand(-1, 5)
    assert clustered_error(alike.flatten(), models) > clustered_error(right.flatten(), models)


def test_rows_of_the_confusion_matrix_are_true_classes():
    truth, answered = torch.tensor([0, 0, 1, 2]), torch.tensor([0, 2, 1, 1])
    assert confusion(answered, truth, 3) == [[1, 0, 1], [0, 1, 0], [0, 1, 0]]


def test_counts_of_classes_and_renderers_add_up():
    split = committed()
    count = len(split.classes)
    classes = torch.arange(count).repeat_interleave(4)
    images = Images(
        torch.zeros(0), classes, torch.arange(2 * count).repeat_interleave(2), torch.tensor([0, 1] * 2 * count)
    )
    answered = classes.clone()
    answered[::4] = (answered[::4] + 1) % count  # one of the four views of each class, the torch renderer's
    found = measured(answered, images, split)
    assert found["accuracy"]["share"] == 0.75
    assert found["by_renderer"]["torch"]["share"] == 0.5
    assert found["by_renderer"]["pyrender"]["share"] == 1.0
    assert all(share["right"] == 3 and share["models"] == 2 for share in found["by_class"].values())
