from dataclasses import replace

import numpy as np
import pytest
import torch

from scene_attack.errors import InvalidRequest
from scene_attack.runs.set_up import read_folder
from scene_attack.targets.architectures import fill_by_name
from scene_attack.targets.custom.card import NOTHING
from scene_attack.targets.weights_file import dequantize, quantize
from training.batches import normalised, shade
from training.export import ARCHITECTURES, architecture, write_target
from training.split import committed
from training.training import RECIPES, Budget, TrainableAlexNet, Training, gather, load_trained, one_look, weights

pytestmark = pytest.mark.slow

MODELS = [(0, "couch"), (1, "chair")]
STEPS = 4


@pytest.fixture(scope="module", autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def _recipe(name, **changes):
    return replace(RECIPES[name], views=4, batch=4, looks=2, **changes)


@pytest.fixture(scope="module")
def data(library, tmp_path_factory):
    cache = tmp_path_factory.mktemp("cache")
    return gather(library, cache, _recipe("alexnet"), MODELS, 0, lambda *_: None)


def _training(data, path, name="alexnet", **changes):
    return Training(_recipe(name, hints=0.0, **changes), len(MODELS), data, 0, path)


def _equal(a, b):
    return all(torch.equal(a[name], b[name]) for name in a) and a.keys() == b.keys()


@pytest.mark.parametrize("name", ["alexnet", "resnet34"])
def test_a_resumed_training_has_the_bits_of_an_uninterrupted_one(data, tmp_path, name):
    budget = Budget(epochs=2)  # two steps an epoch
    whole = _training(data, tmp_path / "whole", name)
    whole.run(budget, lambda _: None)
    part = _training(data, tmp_path / "part", name)
    part.run(budget, lambda _: None, stop=lambda step: step == 3)
    assert not (tmp_path / "part").exists()
    part.loop.save()
    resumed = _training(data, tmp_path / "part", name)
    assert resumed.loop.step == 3
    resumed.run(budget, lambda _: None)
    assert whole.loop.step == resumed.loop.step == STEPS
    assert _equal(whole.network.state_dict(), resumed.network.state_dict())
    assert _equal(weights(whole.network), weights(load_trained(whole.recipe, 2, tmp_path / "part").network))


def test_steps_change_the_weights_and_a_seed_changes_the_steps(data, tmp_path):
    first = _training(data, tmp_path / "a")
    before = {name: value.clone() for name, value in first.network.state_dict().items()}
    first.run(Budget(epochs=1), lambda _: None)
    assert not _equal(before, first.network.state_dict())
    other = Training(first.recipe, 2, data, 1, tmp_path / "b")
    other.run(Budget(epochs=1), lambda _: None)
    assert not _equal(first.network.state_dict(), other.network.state_dict())


def test_a_checkpoint_of_another_training_is_refused(data, tmp_path):
    _training(data, tmp_path / "a").loop.save()
    with pytest.raises(InvalidRequest, match="is a checkpoint of"):
        _training(data, tmp_path / "a", rate=1.0)


def test_it_learns_its_views(data, tmp_path, monkeypatch):
    monkeypatch.setattr("training.training.distort", lambda images, *_: images)
    training = _training(data, tmp_path / "a", dropout=0.0, warm_up=0.1, smoothing=0.0)
    reports = []
    training.run(Budget(epochs=45), reports.append)
    assert reports[-1].losses["right"] > 0.75  # 0.5 by chance
    assert reports[-1].losses["loss"] < 0.6  # log 2 by chance


def test_late_batches_show_the_default_scene(data, tmp_path, monkeypatch):
    training = _training(data, tmp_path / "a", default_from=0.5)
    seen = []
    monkeypatch.setattr(
        "training.training.shade",
        lambda views, looks, choices: seen.append((looks, choices)) or shade(views, looks, choices),
    )
    training.run(Budget(epochs=20), lambda _: None)  # 40 steps
    default = [looks is data.default_looks for looks, _ in seen]
    assert not any(default[:20])
    assert 10 <= sum(default[20:]) <= 19  # 16 of 20 are expected
    assert all((choices.tints == 1).all() for (_, choices), late in zip(seen, default, strict=True) if late)
    assert (
        len({int(look) for (_, choices), late in zip(seen, default, strict=True) if late for look in choices.looks})
        > 20
    )


def test_rates_and_hints_follow_the_progress():
    recipe = RECIPES["resnet34"]
    assert recipe.rate_at(recipe.warm_up) == pytest.approx(recipe.rate)
    assert recipe.rate_at(1.0) == pytest.approx(0.0, abs=1e-12)
    assert recipe.rate_at((1 + recipe.warm_up) / 2) == pytest.approx(recipe.rate / 2)
    assert replace(recipe, hints=2.0).hints_at(0.25) == pytest.approx(1.0)
    assert recipe.hints_at(0.6) == 0.0
    assert Budget(minutes=2).progress(10, 5, 30.0) == pytest.approx(0.25)
    assert Budget(epochs=4).progress(10, 5, 30.0) == pytest.approx(0.5)


def test_folded_weights_give_alexnet_itself():
    torch.manual_seed(0)
    trained = TrainableAlexNet(5, dropout=0.2, rank=8)
    x = torch.rand(6, 3, 112, 112)
    for _ in range(3):
        trained(x)  # moves the statistics of the normalisation away from 0 and 1
    trained.eval()
    state = trained.folded()
    for number in (1, 4):
        name = f"classifier.{number}.weight"
        state[name] = state.pop(f"{name}.left") @ state.pop(f"{name}.right")
    plain = ARCHITECTURES["alexnet"](5).eval()
    plain.load_state_dict(state)
    with torch.no_grad():
        assert torch.allclose(plain(x), trained(x), rtol=1e-4, atol=1e-5)


def test_quantised_weights_are_within_half_a_step_and_multiply_out():
    torch.manual_seed(0)
    state = weights(TrainableAlexNet(5, dropout=0.0, rank=8).eval())
    stored = quantize(state)
    found = dequantize(stored)
    kernel = state["features.3.weight"]
    step = kernel.flatten(1).abs().amax(1) / 127
    assert float(((found["features.3.weight"] - kernel).abs().flatten(1).amax(1) / step).max()) <= 0.5 + 1e-4
    product = state["classifier.1.weight.left"] @ state["classifier.1.weight.right"]
    error = (found["classifier.1.weight"] - product).norm() / product.norm()
    assert 0 < float(error) < 0.01
    assert stored["classifier.1.weight.left"].dtype == torch.int8
    network = ARCHITECTURES["alexnet"](5)
    fill_by_name(network, found)
    with pytest.raises(ValueError, match=r"classifier\.6\.bias"):
        fill_by_name(network, {name: value for name, value in found.items() if name != "classifier.6.bias"})


def test_hints_are_uncorrelated_and_of_unit_variance(library, tmp_path):
    data = gather(library, tmp_path, _recipe("resnet34", hints=1.0), MODELS, 0, lambda *_: None)
    hints = data.hints[:, -3:].double()
    assert torch.allclose(hints.T @ hints / len(hints), torch.eye(3, dtype=torch.float64), atol=1e-2)
    training = Training(_recipe("resnet34", hints=1.0), 2, data, 0, tmp_path / "a")
    before = training.head.weight.clone()
    training.run(Budget(epochs=1), lambda _: None)
    assert not torch.equal(training.head.weight, before)


def test_one_look_shows_one_light_and_one_material(library, tmp_path):
    """Every image of a view is that view, moved or mirrored, in plastic under the default map: only the light's side
    differs."""
    recipe = replace(one_look(RECIPES["alexnet"]), views=2, batch=4)
    data = gather(library, tmp_path, recipe, MODELS, 0, lambda *_: None)
    assert (len(data.looks), len(data.default_looks)) == (0, 24)
    training = Training(recipe, len(MODELS), data, 0, tmp_path / "a")
    shown = training.images(np.arange(4), 0.0, np.random.default_rng(0))
    again = training.images(np.arange(4), 0.9, np.random.default_rng(0))
    assert torch.equal(shown, again)
    ground = shown.flatten(2)[..., 0]
    assert torch.equal(ground, ground[:1, :1].expand_as(ground))
    training.run(Budget(epochs=1), lambda _: None)
    trained = load_trained(recipe, 2, tmp_path / "a")
    folder = write_target(
        recipe, trained, committed().model_copy(update={"classes": ("sofa", "chair")}), tmp_path / "out"
    )
    found = read_folder(folder, NOTHING, "trained")
    assert found.info.vocabulary == "custom"
    images = torch.rand(3, 112, 112, 3, generator=torch.Generator().manual_seed(0))
    alone = architecture("alexnet", 2, dequantize(quantize(weights(trained.network))))
    with torch.no_grad():
        wanted = alone(normalised(images.permute(0, 3, 1, 2)))
        assert torch.allclose(found.load(torch.float32).logits(images), wanted, atol=1e-4)
