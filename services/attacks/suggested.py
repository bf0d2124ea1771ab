"""Settings that a request leaves out and the renderer suggests for its groups. This module does not import torch."""

from collections.abc import Callable
from typing import Any, ClassVar, Self

from pydantic import Field, model_validator

from services.attacks.limits import Limit
from services.attacks.spec import AttackSettings, Rate
from services.rendering.declaration import RENDERERS, Group

HALF_STEP = 1 / 16
"""The default half-step, in ε."""


def suggested(data: dict[str, Any], field: str, suggestion: Callable[[Group], float | None]) -> dict[str, Any]:
    """Request data with the groups that `field`, an object by group, leaves out filled in by `suggestion`.

    Data that is invalid is returned as it is; the field's own validation refuses it.
    """
    renderer = RENDERERS.get(str(data.get("renderer")))
    given, attacked = data.get(field) or {}, data.get("groups")
    if renderer is None or not isinstance(given, dict) or not isinstance(attacked, list | tuple):
        return data
    values = {group.name: suggestion(group) for group in renderer.groups if group.name in attacked}
    return data | {field: {group: value for group, value in values.items() if value is not None} | given}


def suggested_limits(data: dict[str, Any]) -> dict[str, Any]:
    """Request data with each attacked group's `epsilon`, by default the limit that the renderer suggests."""
    return suggested(data, "epsilon", lambda group: group.suggested_limit)


class SuggestedRates(AttackSettings):
    """Settings of a method with a learning rate for each attacked group, by default the step its renderer suggests."""

    learning_rate: dict[str, Rate] = Field(default_factory=dict)

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the learning rates that the renderer suggests for its groups."""
        return suggested(data, "learning_rate", lambda group: group.suggested_step)

    @model_validator(mode="after")
    def _a_rate_for_each_group(self) -> Self:
        self.check_groups("learning_rate", self.learning_rate)
        return self


class DifferencesWithinLimits(AttackSettings):
    """Settings of a method that takes differences within ε and moves by Adam; both steps follow from ε."""

    rate_in_epsilon: ClassVar[float] = 1 / 16
    """The default learning rate, in ε."""

    delta: dict[str, Limit] = Field(
        default_factory=dict,
        description="half-step of the difference of each group, in the group's units; default: 1/16 of its `epsilon`",
    )
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="Adam's learning rate of each group, in the group's units; default: 1/16 of its `epsilon`",
    )

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the limits that the renderer suggests for its groups, and what follows from them."""
        data = suggested_limits(data)
        limits = data.get("epsilon")
        if not isinstance(limits, dict):
            return data
        for field, share in (("delta", HALF_STEP), ("learning_rate", cls.rate_in_epsilon)):
            given = data.get(field) or {}
            if isinstance(given, dict):
                values = {group: share * limit for group, limit in limits.items() if isinstance(limit, int | float)}
                data = data | {field: values | given}
        return data

    @model_validator(mode="after")
    def _a_value_for_each_group(self) -> Self:
        self.check_groups("epsilon", self.epsilon)
        self.check_groups("delta", self.delta)
        self.check_groups("learning_rate", self.learning_rate)
        return self
