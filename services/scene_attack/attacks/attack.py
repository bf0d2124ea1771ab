"""The base class of all attacks, and their registry. This module does not import torch.

An attack is one file with one class, which derives from `Attack` and is registered by `@register`; ours are listed at
`ATTACKS`. The request's union of attacks, the paths of errors, openapi.yaml and docs/reference/fields.md follow from
the registry.
"""

import operator
from collections.abc import Callable, Iterable, Mapping
from math import isfinite, sqrt
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeVar, get_args, get_origin

from pydantic import (
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from scene_attack.attacks.request import Expectation, Loss
from scene_attack.plugins import Registry
from scene_attack.rendering.declaration import MAX_STEP, RENDERERS, SHORTEST_WAVE, Group
from scene_attack.strict import Model, Several, absent, schema_of
from scene_attack.text import there_are

if TYPE_CHECKING:
    from torch import Tensor

    from scene_attack.attacks.problem import AttackProblem, Evaluation

    State = dict[str, Tensor]
else:
    State = dict
"""State that an attack keeps from step to step: tensors by name, among them `delta` [total], its perturbation."""
Limit = Annotated[float, Field(gt=0, le=MAX_STEP, allow_inf_nan=False)]
Value = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Rate = Annotated[float, Field(ge=0, le=MAX_STEP, allow_inf_nan=False)]


def _base_renderers() -> list[str]:
    """Names of the renderers that need no base renderer."""
    return [name for name, declaration in RENDERERS.items() if declaration.base_renderer is None]


def renderer_names(schema: dict[str, Any]) -> None:
    """Adds the renderers' names to the JSON schema of a field."""
    schema["enum"] = list(RENDERERS)


def _base_renderer_names(schema: dict[str, Any]) -> None:
    schema["anyOf"][0]["enum"] = _base_renderers()


class _OfTheRenderer:
    """Validates settings by the model that the renderer declares, which an earlier field of the attack names."""

    @staticmethod
    def __get_pydantic_core_schema__(_source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        def validate(data: object, info: ValidationInfo) -> Model | None:
            renderer = RENDERERS.get(info.data.get("renderer", ""))  # it may be refused itself
            if data is None or renderer is None:
                return None
            if renderer.settings is None:
                raise ValueError(f"renderer {renderer.name} has no settings of its own; leave this out")
            return renderer.settings.model_validate(data, context=info.context)  # its errors become those of the field

        return core_schema.with_info_plain_validator_function(validate)

    @staticmethod
    def __get_pydantic_json_schema__(_schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        models = [renderer.settings for renderer in RENDERERS.values() if renderer.settings is not None]
        return schema_of(list(dict.fromkeys(models)), handler)


AnySettings = Annotated[Any, _OfTheRenderer]


class Attack(Model):
    """Settings that every method has. Settings left out are filled in, so that the stored spec states all of them.

    An attack derives from this class: settings are fields, and `init` and `step` are the method. It adds fields, among
    them `method: Literal["its-name"] = "its-name"`, states `needs_gradient`, and may narrow `steps` and `truncation` or
    give them other defaults.
    """

    needs_gradient: ClassVar[bool]
    """Whether `step` reads `evaluation.gradient`: the network's scores must then have gradients; the renderer may have
    none."""
    needs_metric: ClassVar[bool] = False
    """Whether `step` reads `evaluation.metric`, and so measures its steps by the change of the image."""

    per_group: ClassVar[tuple[str, ...]] = ()
    """Fields of the method that need a value for each attacked group, where they have values by group."""

    truncation: Annotated[int, Field(ge=1, le=255)] | None = Field(
        default=None,
        description="U: largest change of an RGB value from the original inside the loop, in 1/255; null: no limit",
    )
    constraint: Literal["truncate", "backtrack", "epsilon"] = Field(
        default="truncate",
        description="`truncate`: values of the image beyond U are clamped, as in the paper; `backtrack`: after each "
        "step all parameters are pulled back towards the scene's own until no value is beyond U and p is within "
        "`perceptibility`, so that image and scene agree; `epsilon`: there is no U, `epsilon` alone limits",
    )
    perceptibility: Annotated[float, Field(gt=0, le=sqrt(3), allow_inf_nan=False)] | None = Field(
        default=None, description="with `backtrack`: the largest p of the image; null: no limit, U alone limits"
    )
    epsilon: dict[str, Limit] = Field(
        default_factory=dict,
        description="ε: largest change of a parameter from the scene's own value, by group, in the group's units; a "
        "group that is left out has its natural range, if it has one, or no limit, or, with a method that needs one, "
        "the limit that its renderer suggests",
        examples=[{"bump": 10}],
    )
    bounds: dict[str, tuple[Value, Value]] = Field(
        default_factory=dict,
        description="smallest and largest value of the parameters, by group, in the group's units; the scene's own "
        "values must be within, and nothing may be that the renderer cannot draw",
        examples=[{"lamp": [-0.5, 0.5]}],
    )
    restarts: Annotated[int, Field(ge=0, le=100)] = Field(
        default=0,
        description="further starts after an attempt of `steps` steps without success, each at a random point within "
        "`epsilon`",
    )
    renderer: str = Field(
        default="torch", description="the renderer whose parameters are attacked", json_schema_extra=renderer_names
    )
    groups: Several[str] = Field(
        default=(),  # type: ignore[arg-type]
        max_length=8,
        description="the parameter groups to attack; empty means the renderer's default groups",
    )
    base_renderer: str | None = Field(
        default=None,
        description="for a renderer that changes another renderer's image, as `image` does: the renderer of that "
        "image; default torch",
        json_schema_extra=_base_renderer_names,
    )
    renderer_settings: AnySettings = Field(
        default=None,
        exclude_if=absent,
        description="settings that the renderer itself has; default: that of each setting, or null if it has none",
    )
    queries: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        default=None, description="limit of network queries, after which the attack stops"
    )
    seconds: Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)] | None = Field(
        default=None,
        description="limit of run time in seconds; a job that reaches it may end differently on another machine",
    )
    expectation: Expectation | None = Field(
        default=None,
        description="views, light and cameras over which the adversary is to hold, so that the attack lowers the "
        "mean objective; null: the scene itself alone",
    )
    wavelength: Annotated[float, Field(ge=SHORTEST_WAVE, le=1)] | None = Field(
        default=None,
        exclude_if=operator.not_,
        description="for groups with waves (`bump`, `shape`, `paint`): the shortest of them, in sizes of the object; "
        "default: 0.1",
    )
    leave_out: dict[str, Limit] = Field(
        default_factory=dict,
        exclude_if=operator.not_,
        description="for groups of few coordinates: each is moved by this much before the attack, and those that "
        "hardly change the answer's advantage, all together by at most 1 %, are left out of the search; default: none",
    )
    method: str
    steps: Annotated[int, Field(ge=1, le=100_000)] = Field(default=500, description="largest number of steps")

    def init(self, problem: "AttackProblem") -> State:
        """Returns the state with which a start begins: tensors by name, among them `delta` [total], the perturbation to
        look at first. `problem.start` is zero, or random for a restart. It may measure, which takes images and queries.
        """
        raise NotImplementedError

    def step(self, problem: "AttackProblem", state: State, evaluation: "Evaluation") -> State:
        """Returns the state after a step, given that before it and what `delta` of it looks like to the network.

        Everything that a later step depends on must be in the state: a checkpoint saves nothing else. `delta` must be
        finite and within `problem.limits`, whose `clamp` keeps it there; the job ends otherwise. A count of estimates
        below the noise, for the trace, is `below_noise`. Random numbers are drawn from `problem.generator`.
        """
        raise NotImplementedError

    def measured(self, problem: "AttackProblem", state: State) -> dict[str, object]:  # noqa: ARG002
        """The settings that `init` found by measuring, as JSON."""
        return {}

    @property
    def distance_weight(self) -> float:
        """λ: weight of the summed squares of the image's change in the objective of finite differences."""
        return 0.0

    @property
    def objective(self) -> Loss:
        """The loss whose gradient the loop computes, and whose value it gives to the method."""
        return "log-odds"

    @property
    def guide(self) -> str | None:
        """The target whose gradients guide the search; None: there is none."""
        return None

    @property
    def masking_check(self) -> int:
        """Queries of the check for masked gradients after an attack that held; 0: there is none."""
        return 0

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in settings that the method derives from the renderer and the groups. The base class derives none."""
        return data

    @model_validator(mode="before")
    @classmethod
    def _no_truncation_by_default(cls, data: Any) -> Any:
        """Leaves out a default U where the request says that ε alone limits, where views or light vary, where groups
        have natural ranges, and through a renderer without gradients: there objects move, and pixels at silhouettes
        exceed any U at once. Backtracking needs a U, or a largest p.
        """
        if not isinstance(data, dict) or "truncation" in data:
            return data
        renderer = RENDERERS.get(str(data.get("renderer")))
        moving = renderer is not None and not renderer.differentiable
        varying = data.get("expectation") is not None
        groups = data.get("groups")  # which `_complete` has filled in
        natural = (
            renderer is not None
            and isinstance(groups, (list, tuple))
            and all(group in renderer.natural_groups for group in groups)
        )
        needed = data.get("constraint") == "backtrack" and data.get("perceptibility") is None
        without = ((moving or varying or natural) and not needed) or data.get("constraint") == "epsilon"
        return data | {"truncation": None} if without else data

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any) -> Any:
        return cls.complete(_completed(cls, data)) if isinstance(data, dict) else data

    @model_validator(mode="wrap")
    @classmethod
    def _stated(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Counts as set what was given, and the method, but not what is filled in: written without unset fields, an
        attack is the request that it was read from.
        """
        attack = handler(data)
        if isinstance(data, dict):
            attack.__pydantic_fields_set__.intersection_update(data)
            attack.__pydantic_fields_set__.add("method")
        return attack

    @field_validator("renderer")
    @classmethod
    def _known_renderer(cls, value: str) -> str:
        return _one_of(list(RENDERERS), value)

    @field_validator("base_renderer")
    @classmethod
    def _known_base_renderer(cls, value: str | None) -> str | None:
        return None if value is None else _one_of(_base_renderers(), value)

    @field_validator("groups")
    @classmethod
    def _known_groups(cls, value: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        renderer = RENDERERS.get(info.data.get("renderer", ""))  # it may be refused itself
        for group in value:
            if renderer is not None and group not in renderer.group_names:
                known_groups = there_are(group, renderer.group_names)
                raise ValueError(f"renderer {renderer.name} has no group {group!r}; {known_groups}")
        if len(set(value)) != len(value):
            raise ValueError("each group at most once")
        return value

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

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        has = RENDERERS[self.renderer]
        if self.base_renderer is not None and has.base_renderer is None:
            raise ValueError(f"base_renderer: renderer {self.renderer} works on no other's image; leave this out")
        if self.expectation is not None:
            self.expectation.check(has, self.groups)
            if self.truncation is not None:
                raise ValueError("truncation: U is of one view in one light; with `expectation` leave it out")
        if self.wavelength is not None and not any(has.group(name).waves for name in self.groups):
            offered = [group.name for group in has.groups if group.waves]
            them = f"only {', '.join(offered)} do" if offered else f"no group of {has.name} does"
            raise ValueError(f"wavelength: no attacked group has waves; {them}")
        pixels = [name for name in self.groups if has.group(name).per_pixel]
        moving = [name for name in self.groups if name in has.moving_groups]
        if pixels and moving:
            belong = f"{pixels[0]} belong to the pixels of one view, which {moving[0]} changes"
            raise ValueError(f"groups: {belong}; attack one of the two")
        for field, groups in (("epsilon", self.epsilon), ("bounds", self.bounds), ("leave_out", self.leave_out)):
            self.check_known(field, groups)
        if self.constraint == "epsilon" or self.restarts > 0:
            self.check_groups("epsilon", self.epsilon)
        for field in self.per_group:
            if isinstance(value := getattr(self, field), dict):
                self.check_groups(field, value)
        return self

    def check_known(self, field: str, given: Iterable[str]) -> None:
        """Raises ValueError unless each group in `given` is attacked."""
        for group in given:
            if group not in self.groups:
                attacked = ", ".join(self.groups)
                raise ValueError(f"{field}: {group!r} is not an attacked group; attacked are {attacked}")

    def check_groups(self, field: str, given: Mapping[str, object]) -> None:
        """Raises ValueError unless `given` has a value for each attacked group and for no other."""
        self.check_known(field, given)
        for group in self.groups:
            if group not in given:
                raise ValueError(f"{field}: group {group!r} has no value")


def _one_of(names: list[str], value: str) -> str:
    if value not in names:
        raise ValueError(f"there is no {value!r}; {there_are(value, names)}")
    return value


def _completed(settings: type[Attack], fields: dict[str, Any]) -> dict[str, Any]:
    """The data with renderer, groups and base renderer filled in where they were left out."""
    data = {"renderer": settings.model_fields["renderer"].default} | fields
    renderer = RENDERERS.get(data["renderer"]) if isinstance(data["renderer"], str) else None
    if renderer is None:
        return data
    asked = data.get("groups", ())
    if isinstance(asked, (list, tuple)) and all(group in renderer.group_names for group in asked):
        # the same request, whatever order it was written in
        data["groups"] = sorted(asked, key=renderer.group_names.index) or renderer.default_groups
    if data.get("base_renderer") is None:
        data["base_renderer"] = renderer.base_renderer
    if renderer.settings is not None and data.get("renderer_settings") is None:
        data["renderer_settings"] = {}
    return suggested(data, "epsilon", lambda group: group.suggested_limit if group.natural_range else None)


_BUILT_IN = ("apgd", "cma_es", "fgsm", "mi_fgsm", "natural_gradient", "p_rgf", "spsa", "square", "zoo")
ATTACKS: Registry[type[Attack]] = Registry("method", [f"scene_attack.attacks.{name}" for name in _BUILT_IN])

AnyAttack = TypeVar("AnyAttack", bound=Attack)


def register(attack: type[AnyAttack]) -> type[AnyAttack]:
    """A class decorator that registers an attack under the name in its field `method`.

    Raises ValueError if the class does not derive from `Attack`, if that field is not a `Literal` of one name, if that
    name or the class's is taken, if a default is not finite, or if the class lacks `needs_gradient`, `init` or `step`.
    Raises pydantic's errors if the settings have no JSON schema.
    """
    if not issubclass(attack, Attack):
        raise ValueError(f"{attack.__name__} does not derive from Attack")
    attack.model_json_schema()
    annotation = attack.model_fields["method"].annotation
    if get_origin(annotation) is not Literal or len(get_args(annotation)) != 1:
        raise ValueError(f'{attack.__name__} needs a field method: Literal["its-name"] = "its-name"')
    (name,) = get_args(annotation)
    for field, about in attack.model_fields.items():
        if isinstance(about.default, float) and not isfinite(about.default):
            raise ValueError(f"the default of {field} is {about.default}, which no request can state")
    missing = [part for part in ("init", "step") if getattr(attack, part) is getattr(Attack, part)]
    if missing:
        raise ValueError(f"{attack.__name__} has no {' and no '.join(missing)}")
    if not isinstance(getattr(attack, "needs_gradient", None), bool):
        raise ValueError(f"{attack.__name__}.needs_gradient is no bool; state it as a ClassVar[bool]")
    others = ATTACKS.so_far()
    if name not in others and any(other.__name__ == attack.__name__ for other in others.values()):
        raise ValueError(f"there is an attack {attack.__name__} already; openapi.yaml calls them by their class")
    ATTACKS.add(name, attack)
    return attack


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
    stated, attacked = data.get(field, {}), data.get("groups")
    if renderer is None or not isinstance(stated, dict) or not isinstance(attacked, list | tuple):
        return data
    values = {group.name: suggestion(group) for group in renderer.groups if group.name in attacked}
    return data | {field: {group: value for group, value in values.items() if value is not None} | stated}


def suggested_limits(data: dict[str, Any]) -> dict[str, Any]:
    """Request data with each attacked group's `epsilon`, by default the limit that the renderer suggests."""
    return suggested(data, "epsilon", lambda group: group.suggested_limit)


def in_scale(data: dict[str, Any], field: str, share: float) -> dict[str, Any]:
    """Request data with `field`, by default this share of each attacked group's scale: its ε, or without one the larger
    of `STEPS_OF_SCALE` of the steps and the ε that its renderer suggests.
    """
    limits, stated = data.get("epsilon", {}), data.get(field, {})
    if not isinstance(limits, dict) or not isinstance(stated, dict):
        return data
    values = {group: share * limit for group, limit in limits.items() if isinstance(limit, int | float)}
    return suggested(data | {field: values | stated}, field, lambda group: _scaled(group, share))


def _scaled(group: Group, share: float) -> float | None:
    if group.suggested_step is None:
        return None
    return share * max(STEPS_OF_SCALE * group.suggested_step, group.suggested_limit or 0.0)


class SuggestedRates(Attack):
    """Settings of a method with a learning rate for each attacked group, by default the step its renderer suggests."""

    per_group: ClassVar[tuple[str, ...]] = ("learning_rate",)
    learning_rate: dict[str, Rate] = Field(default_factory=dict)

    @classmethod
    def complete(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fills in the learning rates that the renderer suggests for its groups."""
        return suggested(data, "learning_rate", lambda group: group.suggested_step)


class SearchWithinLimits(Attack):
    """Settings of a search that needs a limit: U, p, or an ε of each group, which its renderer suggests."""

    epsilon: dict[str, Limit] = Field(
        default_factory=dict,
        description="ε: largest change of a parameter from the scene's own value, by group, in the group's units; a "
        "group that is left out has its natural range, if it has one; else no limit where `truncation` or "
        "`perceptibility` limits the search, or the limit that its renderer suggests",
        examples=[{"translation": 0.01}],
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
    per_group: ClassVar[tuple[str, ...]] = ("delta", "learning_rate")

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
