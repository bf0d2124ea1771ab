"""Settings that a request leaves out and the renderer suggests for its groups. This module does not import torch."""

from collections.abc import Callable
from typing import Any, ClassVar, Self

from pydantic import Field, model_validator

from services.attacks.limits import Limit
from services.attacks.spec import AttackSettings, Rate
from services.rendering.declaration import RENDERERS, Group

HALF_STEP = 1 / 16
"""The default half-step, as a share of a group's scale."""
STEPS_OF_SCALE = 60
"""The scale of a group that has no ε, in the steps that its renderer suggests, and at least the ε that it suggests. For
pyrender's light and colours it is 0.3, for positions 0.03 scene units, for rotations 0.1 radians; for the torch
renderer's light and material 3, as their steps are small beside what fools."""


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


def in_scale(data: dict[str, Any], field: str, share: float) -> dict[str, Any]:
    """Request data with `field`, by default this share of each attacked group's scale: its ε, or without one the larger
    of `STEPS_OF_SCALE` of the steps and the ε that its renderer suggests.
    """
    limits, given = data.get("epsilon") or {}, data.get(field) or {}
    if not isinstance(limits, dict) or not isinstance(given, dict):
        return data
    values = {group: share * limit for group, limit in limits.items() if isinstance(limit, int | float)}
    return suggested(data | {field: values | given}, field, lambda group: _scaled(group, share))


def _scaled(group: Group, share: float) -> float | None:
    if group.suggested_step is None:
        return None
    return share * max(STEPS_OF_SCALE * group.suggested_step, group.suggested_limit or 0.0)


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


class SearchWithinLimits(AttackSettings):
    """Settings of a search that needs a limit: U, p, or an ε of each group, which its renderer suggests."""

    epsilon: dict[str, Limit] = Field(
        default_factory=dict,
        description="ε: largest change of a parameter from the scene's own value, by group, in the group's units; a "
        "group that is left out has no limit where `truncation` or `perceptibility` limits the search, else the limit "
        "that its renderer suggests",
    )

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the ε that the renderer suggests, unless U or p limits the search: an ε that nobody asked for would
        then exclude perturbations that the limit allows.
        """
        limited = data.get("truncation") is not None or data.get("perceptibility") is not None
        return data if limited else suggested_limits(data)

    @model_validator(mode="after")
    def _some_limit(self) -> Self:
        if self.truncation is None and self.perceptibility is None:
            self.check_groups("epsilon", self.epsilon)
        return self


class DifferencesWithinLimits(SearchWithinLimits):
    """Settings of a method that takes differences within limits and moves by Adam; both steps follow from the scale of
    each group: its ε, or what the renderer suggests.
    """

    rate_in_scale: ClassVar[float] = 1 / 16
    """The default learning rate, as a share of a group's scale."""

    delta: dict[str, Limit] = Field(
        default_factory=dict,
        description="half-step of the difference of each group, in the group's units; default: 1/16 of its `epsilon`, "
        "without one 3.75 of the steps that its renderer suggests",
    )
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict,
        description="Adam's learning rate of each group, in the group's units; default: 1/16 of its `epsilon`, without "
        "one 3.75 of the steps that its renderer suggests",
    )

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the limits that the search needs, and both steps."""
        data = in_scale(super().complete(data), "delta", HALF_STEP)
        return in_scale(data, "learning_rate", cls.rate_in_scale)

    @model_validator(mode="after")
    def _a_value_for_each_group(self) -> Self:
        self.check_groups("delta", self.delta)
        self.check_groups("learning_rate", self.learning_rate)
        return self
