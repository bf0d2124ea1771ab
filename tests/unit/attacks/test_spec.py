"""Settings that all attacks share, and how attacks are registered."""

from math import nan
from typing import Literal

import pytest
from pydantic import BaseModel, ValidationError

from services.attacks.fgsm import Fgsm
from services.attacks.spec import ATTACKS, AttackSettings, register
from services.attacks.trace import TraceRow
from services.attacks.zoo import Zoo

ROW = {
    "step": 1, "loss": 0.5, "label": "cat", "confidence": 0.5, "advantage": 1.0, "distance": 0.1, "perceptibility": 0.1,
    "truncated": 0, "queries": 2, "renders": 2, "seconds": 0.1,
}  # fmt: skip


def test_the_built_in_attacks_are_found() -> None:
    found = {name: (one.settings, one.needs_gradient) for name, one in ATTACKS.items()}
    assert (found["fgsm"], found["zoo"]) == ((Fgsm, True), (Zoo, False))


def test_the_old_names_of_fields_are_still_read_and_the_new_ones_written() -> None:
    settings = Fgsm.model_validate({"renderer": "image", "picture": "pyrender"})
    assert settings == Fgsm.model_validate({"renderer": "image", "base_renderer": "pyrender"})
    assert "picture" not in settings.model_dump()
    row = TraceRow.model_validate(ROW | {"flat": 7})
    assert row.below_noise == 7
    assert row == TraceRow.model_validate(ROW | {"below_noise": 7})
    assert row.model_dump()["below_noise"] == 7


def test_both_names_at_once_are_refused() -> None:
    with pytest.raises(ValidationError, match="old name"):
        Fgsm.model_validate({"renderer": "image", "picture": "torch", "base_renderer": "torch"})


def test_learning_rates_are_those_that_the_groups_suggest() -> None:
    rates = {"normals": 0.004, "illumination": 0.003, "material": 0.003}  # paper, section 4.1
    assert Fgsm().learning_rate == rates
    assert Fgsm.model_validate({"groups": ["material"]}).learning_rate == {"material": 0.003}
    assert Fgsm.model_validate({"learning_rate": {"normals": 0.1}}).learning_rate == rates | {"normals": 0.1}
    assert Fgsm.model_validate({"renderer": "image"}).learning_rate == {"image": 0.002}


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
