"""The networks that ship with the project, with their weights and what their files say of them."""

import hashlib
from dataclasses import replace

import pytest
import torch

from scene_attack.rendering.factory import build
from scene_attack.scenes.description import Scene, SceneObject
from scene_attack.scenes.furniture import PREFIX, kind_of
from scene_attack.scenes.library import Library
from scene_attack.scenes.resolve import resolve
from scene_attack.targets import registry
from scene_attack.targets.architectures import fill_by_name
from scene_attack.targets.classifier import Classifier
from scene_attack.targets.image_networks import facts
from scene_attack.targets.info import available, shipped
from scene_attack.targets.networks import AlexNet, ResNet
from scene_attack.targets.weights_file import read
from scene_attack_service.settings import Settings
from training.split import committed

WEIGHTS = shipped("")
CARDS = {info.name: info for info in available() if info.vocabulary == "furniture-14"}


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, torch.Tensor]]:
    """Kind and default view of the first held-out model of every other class."""
    library = Library(Settings().cache_dir, tmp_path_factory.mktemp("data"))
    names = [PREFIX + committed().held_out[kind][0] for kind in committed().classes[::2]]
    scenes = [resolve(Scene(objects=(SceneObject(mesh=name),)), library) for name in names]
    return [
        (kind_of(name) or "", build(scene, "pyrender", tolerance="exact").exact().render({}))
        for name, scene in zip(names, scenes, strict=True)
    ]


def test_every_weights_file_belongs_to_a_target() -> None:
    assert {path.stem for path in WEIGHTS.glob("*.safetensors")} == set(CARDS)


@pytest.mark.parametrize("name", CARDS)
def test_the_file_is_the_one_that_was_measured(name: str) -> None:
    data = (WEIGHTS / f"{name}.safetensors").read_bytes()
    assert hashlib.sha256(data).hexdigest() == facts(name)["sha256"]
    assert registry.load(name).weights_sha256 == facts(name)["sha256"]


@pytest.mark.parametrize("name", CARDS)
def test_labels_are_the_classes_of_the_split(name: str) -> None:
    assert registry.labels(name) == committed().classes == registry.load(name).labels
    assert len(registry.labels(name)) == 14


@pytest.mark.parametrize("name", CARDS)
def test_eight_bits_cost_less_than_half_a_point(name: str) -> None:
    """Or the card has to say so: held-out views are answered by both forms of the weights when they are written."""
    found = facts(name)
    assert found["held_out_before_quantisation"] - found["held_out"]["accuracy"]["share"] < 0.005


@pytest.mark.parametrize("name", CARDS)
def test_the_counts_of_the_card_add_up(name: str) -> None:
    found = facts(name)["held_out"]
    total, confusion = found["accuracy"], torch.tensor(found["confusion"])
    assert int(confusion.sum()) == total["views"] == found["models"] * found["views_per_model"]
    assert int(confusion.diagonal().sum()) == total["right"]
    assert found["models"] == len(committed().models("held_out"))
    for kind, row in zip(facts(name)["labels"], confusion, strict=True):
        assert int(row.sum()) == found["by_class"][kind]["views"]


@pytest.mark.parametrize("name", CARDS)
def test_most_default_views_of_held_out_models_are_right(name: str, views: list[tuple[str, torch.Tensor]]) -> None:
    target = registry.load(name)
    right = [target.labels[int(target.logits(image).argmax())] == kind for kind, image in views]
    assert sum(right) >= len(right) // 2


@pytest.mark.parametrize(("name", "kind"), [("alexnet-furniture", AlexNet), ("resnet34-furniture", ResNet)])
def test_factors_in_two_layers_are_the_same_network(
    name: str, kind: type[AlexNet | ResNet], views: list[tuple[str, torch.Tensor]]
) -> None:
    """As with the matrices multiplied out: scores and gradients differ by the rounding of sums of some 1e-6."""
    target = registry.load(name)
    assert isinstance(target, Classifier)
    network = kind(14)
    fill_by_name(network, read(WEIGHTS / f"{name}.safetensors"))
    whole = replace(target, network=network)
    found = []
    for one in (target, whole):
        image = views[0][1].clone().requires_grad_()
        scores = one.logits(image)[0]
        found.append((scores.detach(), torch.autograd.grad(scores.square().sum(), image)[0]))
    for ours, product in zip(*found, strict=True):
        assert float((ours - product).norm() / product.norm()) < 1e-4
    assert max(value.numel() for value in target.network.parameters()) < 5_000_000  # AlexNet's matrices have 38 million
