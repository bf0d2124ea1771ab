"""Settings that all attacks share, and how attacks are registered."""

from math import nan
from typing import ClassVar, Literal

import pytest
from pydantic import BaseModel, ValidationError

from scene_attack.attacks.attack import ATTACKS, Attack, State, register
from scene_attack.attacks.fgsm import FGSM
from scene_attack.attacks.zoo import ZOO


def test_the_built_in_attacks_are_found() -> None:
    found = {name: (one, one.needs_gradient) for name, one in ATTACKS.items()}
    assert (found["fgsm"], found["zoo"]) == ((FGSM, True), (ZOO, False))


def test_learning_rates_are_those_that_the_groups_suggest() -> None:
    rates = {"normals": 0.004, "illumination": 0.003, "material": 0.003}  # paper, section 4.1
    assert FGSM().learning_rate == rates
    assert FGSM.model_validate({"groups": ["material"]}).learning_rate == {"material": 0.003}
    assert FGSM.model_validate({"learning_rate": {"normals": 0.1}}).learning_rate == rates | {"normals": 0.1}
    assert FGSM.model_validate({"renderer": "image"}).learning_rate == {"image": 0.002}


def test_through_a_renderer_without_gradients_defaults_are_those_that_succeed_there() -> None:
    """What moves silhouettes exceeds any U at once, and the paper's λ outweighs what ZOO may gain."""
    fgsm = FGSM.model_validate({"renderer": "pyrender"})
    steps = {"illumination": 0.005, "color": 0.005, "translation": 0.0005, "rotation": 0.001}
    assert (fgsm.learning_rate, fgsm.truncation) == (steps, None)
    assert FGSM.model_validate({"renderer": "pyrender", "truncation": 9}).truncation == 9
    assert FGSM().truncation == 18
    zoo = ZOO.model_validate({"renderer": "pyrender"})
    assert (zoo.learning_rate, zoo.weight) == ({group: 10 * step for group, step in steps.items()}, 1e-3)
    assert ZOO.model_validate({"renderer": "pyrender", "learning_rate": 0.1, "weight": 0.5}).learning_rate == 0.1
    for renderer, preset in (("pyrender", "paper-classification"), ("torch", "measured"), ("image", "measured")):
        papers = ZOO.model_validate({"renderer": renderer, "preset": preset})
        assert (papers.learning_rate, papers.weight) == (2e-3, 0.1)


@pytest.mark.parametrize(
    "given", [{"groups": {}}, {"groups": ""}, {"groups": False}, {"epsilon": []}, {"groups": ["bump"], "epsilon": 0}]
)
def test_what_is_empty_and_of_another_type_is_not_taken_for_left_out(given: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        FGSM.model_validate(given)


def test_groups_on_request_have_a_rate_when_they_are_named() -> None:
    asked = {"renderer": "pyrender", "groups": ["camera", "color"]}
    assert FGSM.model_validate(asked).learning_rate == {"color": 0.005, "camera": 0.001}
    assert ZOO.model_validate(asked).groups == ("color", "camera")
    assert "camera" not in ZOO.model_validate({"renderer": "pyrender"}).groups


def test_the_weight_of_the_distance_is_the_methods_own() -> None:
    assert FGSM().distance_weight == 0
    assert ZOO.model_validate({"weight": 0.25}).distance_weight == 0.25


class Complete(Attack):
    """All that a method needs, but for its name."""

    needs_gradient: ClassVar[bool] = False

    def init(self, problem: object) -> State:
        return {}

    def step(self, problem: object, state: State, evaluation: object) -> State:
        return state


class Nameless(Complete):
    method: str = "nameless"


class Idle(Attack):
    needs_gradient: ClassVar[bool] = False
    method: Literal["idle"] = "idle"


class Plain(BaseModel):
    method: Literal["plain"] = "plain"


class Odd(Complete):
    method: Literal["odd"] = "odd"
    spread: float = nan


class Vague(Complete):
    method: Literal["vague"] = "vague"
    needs_gradient: ClassVar[str] = "perhaps"  # type: ignore[assignment]


Fgsm2 = type("FGSM", (Complete,), {"__annotations__": {"method": Literal["other"]}, "method": "other"})
"""The component FGSM of the OpenAPI document got the name of its module, which clients do not know."""


@pytest.mark.parametrize(
    ("attack", "words"),
    [
        (Nameless, r'method: Literal\["its-name"\]'),
        (Idle, "Idle has no init and no step"),
        (Plain, "Plain does not derive from Attack"),
        (Odd, "the default of spread is nan"),
        (Vague, "Vague.needs_gradient is no bool"),
        (Fgsm2, "there is an attack FGSM already"),
    ],
)
def test_what_requests_could_not_use_is_refused(attack: type[Attack], words: str) -> None:
    before = set(ATTACKS)
    with pytest.raises(ValueError, match=words):
        register(attack)
    assert set(ATTACKS) == before
