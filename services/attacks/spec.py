"""The attack and the goal of a request, with the paper's settings as defaults.

Settings left out are filled from the method's preset, so that the echoed spec says every number that ran.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from services.scenes.description import Model

Rate = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
Step = Annotated[float, Field(ge=1e-12, le=1, allow_inf_nan=False)]
Label = Annotated[str, Field(min_length=1, max_length=200)] | Annotated[int, Field(ge=0)]

LARGEST_SEED = 2**63 - 1
Seed = Annotated[int, Field(ge=0, le=LARGEST_SEED)]

RENDERER_GROUPS = {
    "image": ("image",),
    "torch": ("normals", "illumination", "material"),
    "pyrender": ("illumination", "color", "translation", "rotation"),
}
"""The groups each renderer has, in the order of every table (design: one protocol)."""

DIFFERENTIABLE = ("image", "torch")

FGSM_RATES = {"image": 0.002, "normals": 0.004, "illumination": 0.003, "material": 0.003}
"""Learning rates of the paper, section 4.1; groups it did not attack this way have none."""

ZOO_PRESETS: dict[str, dict[str, Any]] = {
    "paper-classification": {"delta": 1e-4, "learning_rate": 2e-3, "weight": 0.1, "steps": 500},
    "paper-vqa": {"delta": 1e-3, "learning_rate": 1e-2, "weight": 0.5, "steps": 500},
    "measured": {"delta": "measured", "learning_rate": 2e-3, "weight": 0.1, "steps": 500},
}
"""Settings of the paper (sections 4.1 and 4.2), and the same with difference steps chosen from the measured noise."""


class Goal(Model):
    """What the network should be brought to say.

    Non-targeted: `leave` is the true label, which must be the network's first answer to begin with; left out, the
    network's first answer is the label to leave. Targeted: `reach` is the label wanted. A label is a name or an index.
    """

    leave: Label | None = Field(None, description="the true label; the network must stop saying it")
    reach: Label | None = Field(None, description="a label the network must come to say (targeted)")


def _fill_groups(data: dict[str, Any]) -> dict[str, Any]:
    """The data with the groups and the picture's renderer said, where they were left out."""
    data = dict(data)
    renderer = data.get("renderer", "torch")
    if isinstance(renderer, str) and renderer in RENDERER_GROUPS:
        has, asked = RENDERER_GROUPS[renderer], data.get("groups")
        if not asked:
            data["groups"] = has
        elif isinstance(asked, (list, tuple)) and all(group in has for group in asked):
            data["groups"] = sorted(asked, key=has.index)  # the same request, whatever order it was written in
    if renderer == "image" and data.get("picture") is None:
        data["picture"] = "torch"
    return data


class _Attack(Model):
    """What every method has."""

    renderer: Literal["image", "torch", "pyrender"] = Field("torch", description="whose parameters are attacked")
    groups: tuple[str, ...] = Field((), max_length=8, description="parameter groups; empty means all the renderer has")
    picture: Literal["torch", "pyrender"] | None = Field(
        None, description="for renderer `image`: the renderer that draws the picture; default torch"
    )
    queries: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        None, description="stop after so many network queries"
    )
    seconds: Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)] | None = Field(
        None, description="stop after so many seconds; such a job may end differently on another machine"
    )

    @model_validator(mode="after")
    def _consistent(self) -> "_Attack":
        has = RENDERER_GROUPS[self.renderer]
        for group in self.groups:
            if group not in has:
                raise ValueError(f"groups: renderer {self.renderer} has no group {group!r}; it has {', '.join(has)}")
        if len(set(self.groups)) != len(self.groups):
            raise ValueError("groups: each group at most once")
        if self.picture is not None and self.renderer != "image":
            raise ValueError("picture: only renderer `image` takes a picture from another renderer")
        return self


class Fgsm(_Attack):
    """Iterative FGSM: the sign of the gradient, momentum, weight decay on the perturbation (paper, section 3.2)."""

    method: Literal["fgsm"] = "fgsm"
    steps: Annotated[int, Field(ge=1, le=10_000)] = Field(120, description="most steps")
    learning_rate: dict[str, Rate] = Field(
        default_factory=dict, description="per group, in the group's units; default: the paper's"
    )
    momentum: Annotated[float, Field(ge=0, lt=1)] = Field(0.9, description="of the signed gradients")
    weight_decay: Annotated[float, Field(ge=0, le=1)] = Field(1e-4, description="pull of the perturbation towards 0")
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        18, description="U: most an RGB value may move from the original inside the loop, in 1/255; null: no limit"
    )

    @model_validator(mode="before")
    @classmethod
    def _rates(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        data = _fill_groups(data)
        given, groups = data.get("learning_rate") or {}, data.get("groups", ())
        if isinstance(given, dict) and isinstance(groups, (list, tuple)):
            data["learning_rate"] = {g: FGSM_RATES[g] for g in groups if g in FGSM_RATES} | given
        return data

    @model_validator(mode="after")
    def _differentiable(self) -> "Fgsm":
        if self.renderer not in DIFFERENTIABLE:
            raise ValueError(f"method: fgsm needs a differentiable renderer, {self.renderer} is not; use zoo")
        _only_groups("learning_rate", self.learning_rate, self.groups)
        return self


class Zoo(_Attack):
    """Zeroth-order optimisation: central differences on random coordinates, Adam, loss + weight·‖ΔY‖² (section 3.2)."""

    method: Literal["zoo"]
    preset: Literal["paper-classification", "paper-vqa", "measured"] = Field(
        "measured", description="where settings left out come from"
    )
    steps: Annotated[int, Field(ge=1, le=100_000)] = Field(500, description="most steps")
    coordinates: Annotated[int, Field(ge=1, le=4096)] = Field(
        128, description="random coordinates differenced in a step; all of them if there are fewer"
    )
    delta: Step | Literal["measured"] | dict[str, Step] = Field(
        "measured", description="half-step of the central difference, in the group's units, one for all or per group"
    )
    learning_rate: Rate | dict[str, Rate] = Field(2e-3, description="Adam's, in the group's units, one or per group")
    weight: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = Field(
        0.1, description="λ: weight of the summed squares of the picture's change"
    )
    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        None, description="U as for fgsm; the paper keeps changes small by λ alone"
    )

    @model_validator(mode="before")
    @classmethod
    def _preset(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        return _fill_groups(ZOO_PRESETS.get(str(data.get("preset", "measured")), {}) | data)

    @model_validator(mode="after")
    def _known_groups(self) -> "Zoo":
        for name, value in (("delta", self.delta), ("learning_rate", self.learning_rate)):
            if isinstance(value, dict):
                _only_groups(name, value, self.groups)
        return self


def _only_groups(name: str, given: dict[str, float], groups: tuple[str, ...]) -> None:
    for group in given:
        if group not in groups:
            raise ValueError(f"{name}: {group!r} is not an attacked group; attacked are {', '.join(groups)}")
    for group in groups:
        if group not in given:
            raise ValueError(f"{name}: group {group!r} has no value")


AttackSpec = Annotated[Fgsm | Zoo, Field(discriminator="method")]
