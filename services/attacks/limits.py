"""Limits of a perturbation that every method has: U on pixels, ε and bounds on parameters, and restarts within them.

`services.attacks.feasible` applies them. This module does not import torch.
"""

from math import sqrt
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from services.rendering.declaration import MAX_STEP, RENDERERS
from services.scenes.description import Model

Limit = Annotated[float, Field(gt=0, le=MAX_STEP, allow_inf_nan=False)]
Value = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]


class Limits(Model):
    """The limits that every attack's settings have: U, ε, bounds and restarts, and how they go together."""

    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        None,
        description="U: largest change of an RGB value from the original inside the loop, in 1/255; null: no limit",
    )
    constraint: Literal["truncate", "backtrack", "epsilon"] = Field(
        "truncate",
        description="`truncate`: values of the image beyond U are clamped, as in the paper; `backtrack`: after each "
        "step all parameters are pulled back towards the scene's own until no value is beyond U and p is within "
        "`perceptibility`, so that image and scene agree; `epsilon`: there is no U, `epsilon` alone limits",
    )
    perceptibility: Annotated[float, Field(gt=0, le=sqrt(3), allow_inf_nan=False)] | None = Field(
        None, description="with `backtrack`: the largest p of the image; null: no limit, U alone limits"
    )
    epsilon: dict[str, Limit] = Field(
        default_factory=dict,
        description="ε: largest change of a parameter from the scene's own value, by group, in the group's units; a "
        "group that is left out has no limit, or, with a method that needs one, the limit that its renderer suggests",
    )
    bounds: dict[str, tuple[Value, Value]] = Field(
        default_factory=dict,
        description="smallest and largest value of the parameters, by group, in the group's units; the scene's own "
        "values must be within",
    )
    restarts: Annotated[int, Field(ge=0, le=100)] = Field(
        0,
        description="further starts after an attempt of `steps` steps without success, each at a random point within "
        "`epsilon`",
    )

    @model_validator(mode="before")
    @classmethod
    def _no_truncation_by_default(cls, data: Any) -> Any:
        """Leaves out a default U where the request says that ε alone limits, where views or light vary, and through a
        renderer without gradients: there objects move, and pixels at silhouettes exceed any U at once. Backtracking
        needs a U, or a largest p.
        """
        if not isinstance(data, dict) or "truncation" in data:
            return data
        renderer = RENDERERS.get(str(data.get("renderer")))
        moving = renderer is not None and not renderer.differentiable
        varying = data.get("expectation") is not None
        needed = data.get("constraint") == "backtrack" and data.get("perceptibility") is None
        without = ((moving or varying) and not needed) or data.get("constraint") == "epsilon"
        return data | {"truncation": None} if without else data

    @model_validator(mode="after")
    def _limits_agree(self) -> Self:
        if self.constraint == "backtrack" and self.truncation is None and self.perceptibility is None:
            raise ValueError(
                "truncation: `backtrack` keeps every value of the image within U; give U, from 1 to 255, or "
                "`perceptibility`"
            )
        if self.constraint != "backtrack" and self.perceptibility is not None:
            raise ValueError('perceptibility: only `"constraint": "backtrack"` keeps p within a limit')
        if self.constraint == "epsilon" and self.truncation is not None:
            raise ValueError("truncation: with the constraint `epsilon` there is no U; leave it out")
        for group, (low, high) in self.bounds.items():
            if low >= high:
                raise ValueError(f"bounds: those of group {group!r} are {low:g} and {high:g}; the first must be lower")
        return self

    @property
    def needs_epsilon(self) -> bool:
        """Whether each attacked group needs an ε."""
        return self.constraint == "epsilon" or self.restarts > 0
