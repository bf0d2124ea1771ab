"""Settings that all attacks share, and how attacks are registered."""

from math import nan
from typing import Literal

import pytest
from pydantic import BaseModel

from services.attacks.attack import ATTACKS, AttackSettings, register
from services.attacks.fgsm import Fgsm
from services.attacks.zoo import Zoo


def test_the_built_in_attacks_are_found() -> None:
    found = {name: (one.settings, one.needs_gradient) for name, one in ATTACKS.items()}
    assert (found["fgsm"], found["zoo"]) == ((Fgsm, True), (Zoo, False))


def test_learning_rates_are_those_that_the_groups_suggest() -> None:
    rates = {"normals": 0.004, "illumination": 0.003, "material": 0.003}  # paper, section 4.1
    assert Fgsm().learning_rate == rates
    assert Fgsm.model_validate({"groups": ["material"]}).learning_rate == {"material": 0.003}
    assert Fgsm.model_validate({"learning_rate": {"normals": 0.1}}).learning_rate == rates | {"normals": 0.1}
    assert Fgsm.model_validate({"renderer": "image"}).learning_rate == {"image": 0.002}


def test_through_a_renderer_without_gradients_defaults_are_those_that_succeed_there() -> None:
    """What moves silhouettes exceeds any U at once, and the paper's λ outweighs what ZOO may gain."""
    fgsm = Fgsm.model_validate({"renderer": "pyrender"})
    steps = {"illumination": 0.005, "color": 0.005, "translation": 0.0005, "rotation": 0.001}
    assert (fgsm.learning_rate, fgsm.truncation) == (steps, None)
    assert Fgsm.model_validate({"renderer": "pyrender", "truncation": 9}).truncation == 9
    assert Fgsm().truncation == 18
    zoo = Zoo.model_validate({"renderer": "pyrender"})
    assert (zoo.learning_rate, zoo.weight) == ({group: 10 * step for group, step in steps.items()}, 1e-3)
    assert Zoo.model_validate({"renderer": "pyrender", "learning_rate": 0.1, "weight": 0.5}).learning_rate == 0.1
    for renderer, preset in (("pyrender", "paper-classification"), ("torch", "measured"), ("image", "measured")):
        papers = Zoo.model_validate({"renderer": renderer, "preset": preset})
        assert (papers.learning_rate, papers.weight) == (2e-3, 0.1)


def test_groups_on_request_have_a_rate_when_they_are_named() -> None:
    asked = {"renderer": "pyrender", "groups": ["camera", "color"]}
    assert Fgsm.model_validate(asked).learning_rate == {"color": 0.005, "camera": 0.001}
    assert Zoo.model_validate(asked).groups == ("color", "camera")
    assert "camera" not in Zoo.model_validate({"renderer": "pyrender"}).groups


def test_the_weight_of_the_distance_is_the_methods_own() -> None:
    assert Fgsm().distance_weight == 0
    assert Zoo.model_validate({"weight": 0.25}).distance_weight == 0.25


class NoMethod:
    needs_gradient = False


def test_settings_without_a_name_and_classes_without_a_method_are_refused() -> None:
    class Nameless(AttackSettings):
        method: str = "nameless"

    class Named(AttackSettings):
        method: Literal["named"] = "named"

    with pytest.raises(ValueError, match=r'method: Literal\["its-name"\]'):
        register(Nameless)
    with pytest.raises(ValueError, match="NoMethod has no start and no advance and no state and no load"):
        register(Named)(NoMethod)
    assert "named" not in ATTACKS


class Method:
    needs_gradient = False

    def start(self) -> None: ...
    def advance(self) -> None: ...
    def state(self) -> None: ...
    def load(self) -> None: ...


def test_settings_that_requests_could_not_use_are_refused() -> None:
    class Plain(BaseModel):
        method: Literal["plain"] = "plain"

    class Odd(AttackSettings):
        method: Literal["odd"] = "odd"
        spread: float = nan

    class Late(AttackSettings):
        method: Literal["late"] = "late"

    class Property(Method):
        @property
        def needs_gradient(self) -> bool:  # type: ignore[override]
            return False

    with pytest.raises(ValueError, match="Plain does not derive from AttackSettings"):
        register(Plain)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="the default of spread is nan"):
        register(Odd)(Method)
    with pytest.raises(ValueError, match=r"Property.needs_gradient is a property, not a bool"):
        register(Late)(Property)
    assert not {"plain", "odd", "late"} & set(ATTACKS)


def test_settings_of_the_same_class_name_are_refused() -> None:
    """The component Fgsm of the OpenAPI document got the name of its module, which clients do not know."""
    other = type("Fgsm", (AttackSettings,), {"__annotations__": {"method": Literal["other"]}, "method": "other"})
    with pytest.raises(ValueError, match="there are settings Fgsm already"):
        register(other)(Method)
    assert "other" not in ATTACKS
