"""The arguments of `attack`: what is accepted as a network, as labels and as a folder, and what is said of the rest."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from scene_attack import attack
from scene_attack.errors import InvalidRequest

SCENE: dict[str, Any] = {"objects": [{"mesh": "primitive/sphere"}], "camera": {"size": [32, 32]}}
SPEC: dict[str, Any] = {"attack": {"renderer": "image", "steps": 1}}
SEARCH: dict[str, Any] = {"attack": {"renderer": "image", "method": "square", "steps": 2}}
SMALL = {"preprocessing": {"input_size": [8, 8]}}


def network(classes: int = 3, seed: int = 0) -> torch.nn.Module:
    """A linear network of 8×8 images."""
    layer = torch.nn.Linear(192, classes)
    weight = torch.randn(classes, 192, generator=torch.Generator().manual_seed(seed))
    with torch.no_grad():
        layer.weight.copy_(weight)
        layer.bias.zero_()
    return torch.nn.Sequential(torch.nn.Flatten(), layer)


def test_labels_of_none_are_numbers() -> None:
    result = attack(SCENE, network(), SPEC, labels=None, **SMALL)
    assert result.original.label in {"0", "1", "2"}


def test_labels_of_imagenet_are_its_names_and_a_library_mesh_has_its_truth() -> None:
    scene = SCENE | {"objects": [{"mesh": "furniture/grand-piano"}]}
    result = attack(scene, network(1000), SPEC, labels="imagenet", **SMALL)
    assert result.verdict.truth == ["grand piano"]


@pytest.mark.parametrize("kind", [torch.Tensor, np.ndarray, list])
def test_a_function_is_attacked_by_its_scores_and_is_the_module_it_computes(kind: type) -> None:
    module = network()

    def scores(images: torch.Tensor) -> Any:
        assert not images.requires_grad
        found = module(images).detach()
        return found if kind is torch.Tensor else found.numpy() if kind is np.ndarray else found.tolist()

    found, wanted = (attack(SCENE, one, SEARCH, labels=["a", "b", "c"], **SMALL) for one in (scores, module))
    assert (found.original.label, found.attacked.label) == (wanted.original.label, wanted.attacked.label)
    assert dict(found.attacked.top) == pytest.approx(dict(wanted.attacked.top))


def test_a_method_that_needs_gradients_of_a_function_is_refused_with_what_would_do() -> None:
    with pytest.raises(InvalidRequest, match=r"it is a function.*methods without gradients are cma-es") as refused:
        attack(SCENE, lambda images: network()(images), SPEC, **SMALL)
    assert refused.value.field == "attack.method"


@pytest.mark.parametrize(
    ("field", "given", "said"),
    [
        ("labels", "cat", "not 'cat'"),
        ("labels", 5, "not 5"),
        ("labels", ["cat", 7], "not 7 in a list"),
        ("model", "resnet", "not str"),
        ("model", 5, "not int"),
        ("preprocessing", 3, "not int"),
        ("scene", "scene.json", "must be a dictionary, as a request has it, not str"),
        ("spec", [], "must be a dictionary, as a request has it, not list"),
    ],
)
def test_anything_else_is_refused_by_the_name_of_its_argument(field: str, given: Any, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said) as refused:
        attack(**{"scene": SCENE, "model": network(), "spec": SPEC, field: given})
    assert refused.value.field == field


def test_a_folder_with_another_result_is_refused_and_the_same_request_is_taken(tmp_path: Path) -> None:
    attack(SCENE, network(), SPEC, out=tmp_path / "out", **SMALL)
    attack(SCENE, network(), SPEC, out=tmp_path / "out", **SMALL)
    before = (tmp_path / "out" / "result.json").read_bytes()
    others: list[tuple[Any, dict[str, Any], dict[str, Any]]] = [
        (network(seed=1), SPEC, SMALL),
        (network(), SPEC | {"seed": 1}, SMALL),
        (network(), SPEC, SMALL | {"labels": list("xyz")}),
        (network(), SPEC, {"preprocessing": {"input_size": [8, 8], "mean": [0.1, 0.2, 0.3]}}),
        (network().forward, SEARCH, SMALL),
    ]
    for model, spec, about in others:
        with pytest.raises(InvalidRequest, match=r"holds the result of another (job|network)") as refused:
            attack(SCENE, model, spec, out=tmp_path / "out", **about)
        assert refused.value.field == "out"
    attack(SCENE, network().forward, SEARCH, out=tmp_path / "function", **SMALL)
    with pytest.raises(InvalidRequest, match="holds the result of another network"):  # it may be another function
        attack(SCENE, network().forward, SEARCH, out=tmp_path / "function", **SMALL)
    with pytest.raises(InvalidRequest, match="is a file; name a folder"):
        attack(SCENE, network(), SPEC, out=tmp_path / "out" / "result.json", **SMALL)
    assert (tmp_path / "out" / "result.json").read_bytes() == before
