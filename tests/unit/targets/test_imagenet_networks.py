"""Published weights, from a local server in the place of the published address."""

import hashlib
import io
import pickle
from pathlib import Path

import pytest
import torch
from torch import nn

from scene_attack.process import replaced
from scene_attack.targets.image_networks import RESNET34, load_published
from scene_attack.targets.labels import imagenet_labels


def _network() -> nn.Module:
    return nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(3, 1000))


@pytest.fixture
def _cache(tmp_path: Path):
    with replaced(cache=tmp_path):
        yield


def _card(server, data: bytes):
    server.data, server.most = data, len(data)
    digest = hashlib.sha256(data).hexdigest()
    return RESNET34.model_copy(update={"source": f"{server.address}tiny-{digest[:8]}.pth"})


@pytest.mark.usefixtures("_cache")
def test_published_weights_are_loaded_and_normalised_as_torchvision_does(server, tmp_path):
    network = _network()
    buffer = io.BytesIO()
    torch.save(network.state_dict(), buffer)
    card = _card(server, buffer.getvalue())
    target = load_published(card, lambda _: _network(), torch.float32)
    assert target.labels == imagenet_labels()
    assert target.weights_sha256 == hashlib.sha256(buffer.getvalue()).hexdigest()
    image = torch.rand(1, 224, 224, 3)
    mean, scale = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    with torch.no_grad():
        wanted = network(((image - mean) / scale).permute(0, 3, 1, 2))
    assert torch.allclose(target.logits(image), wanted, atol=1e-5)
    load_published(card, lambda _: _network(), torch.float32)
    assert server.starts == [0]
    assert (tmp_path / "weights" / card.source.rpartition("/")[2]).exists()


class _Runs:
    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self):
        return Path.touch, (self._path,)


@pytest.mark.usefixtures("_cache")
def test_a_file_that_runs_code_is_refused_and_does_not_run(server, tmp_path):
    trace = tmp_path / "ran"
    card = _card(server, pickle.dumps(_Runs(trace), protocol=2))
    with pytest.raises(pickle.UnpicklingError):
        load_published(card, lambda _: _network(), torch.float32)
    assert not trace.exists()
