"""A whole request: the same JSON for `POST /v1/jobs` and `scene-attack run`.

The request's union of attacks is made of all that are registered, the operator's extensions among them.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union

from pydantic import Field, ValidationError, model_validator

from services.attacks.spec import AttackSettings, Goal, Seed
from services.errors import InvalidRequest
from services.pipeline.extensions import ATTACKS, RENDERERS
from services.rendering.plan import DEFAULT_TOLERANCE
from services.scenes.description import Model, Scene

if TYPE_CHECKING:
    AnyAttack = AttackSettings
else:
    AnyAttack = Annotated[Union[tuple(one.settings for one in ATTACKS.values())], Field(discriminator="method")]  # noqa: UP007

DEFAULT_TARGET = "efficientnet-lite0"


class TargetChoice(Model):
    """The network under attack, and the question put to it where it takes one."""

    name: str = Field(DEFAULT_TARGET, min_length=1, max_length=100)
    question: str | None = Field(None, max_length=1000, description="for targets that answer questions")


class JobSpec(Model):
    """One attack on one scene. Everything but the objects has a default; the stored spec says them all."""

    scene: Scene
    target: TargetChoice = TargetChoice()
    goal: Goal = Goal()
    attack: AnyAttack = Field(default_factory=lambda: ATTACKS[_method_for({})].settings.model_validate({}))
    tolerance: Annotated[float, Field(ge=1e-6, le=0.1, allow_inf_nan=False)] | Literal["exact"] = Field(
        DEFAULT_TOLERANCE,
        description="largest error of a displayed value, in [0,1], of images inside the attack; `exact` for none; "
        "the verdict is always on the exact image",
    )
    seed: Seed = Field(0, description="of everything random in the job")

    @model_validator(mode="before")
    @classmethod
    def _default_method(cls, data: Any) -> Any:
        """`method` may be left out: then it is the one that the renderer declares."""
        if isinstance(data, dict) and isinstance(data.get("attack"), dict) and "method" not in data["attack"]:
            data = data | {"attack": data["attack"] | {"method": _method_for(data["attack"])}}
        return data


def _method_for(attack: Mapping[str, Any]) -> str:
    """The method of a renderer, where a request names none. An unknown renderer is refused later, by its own field."""
    default = AttackSettings.model_fields["renderer"].default
    renderer = attack.get("renderer", default)
    known = isinstance(renderer, str) and renderer in RENDERERS
    return RENDERERS[renderer if known else default].method


def parse(data: object) -> JobSpec:
    """A spec from JSON data. Raises InvalidRequest naming the first bad field; `problems` has them all."""
    try:
        return JobSpec.model_validate(data)
    except ValidationError as error:
        raise problems(error)[0] from error


def problems(error: ValidationError) -> list[InvalidRequest]:
    """One InvalidRequest per bad field, with the path a client would write (no tags of unions or of the method)."""
    return named(error.errors(include_url=False, include_input=False))


def named(items: Iterable[Mapping[str, Any]]) -> list[InvalidRequest]:
    """The same for pydantic's error items however they came, as from the web framework."""
    found = []
    for item in items:
        path = _written(item["loc"])
        detail = item["msg"].removeprefix("Value error, ")
        if item["type"] == "value_error" and ": " in detail:  # a check over several fields names its own
            name, detail = detail.split(": ", 1)
            path.append(name)
        found.append(InvalidRequest(".".join(path) or "body", detail))
    return found


def _written(place: Iterable[int | str]) -> list[str]:
    """The path as a client writes it: pydantic puts the method after "attack" and the type after a field of several."""
    path: list[str] = []
    tagged = False
    for part in place:
        if part == "body" or _is_type(part) or (tagged and part in ATTACKS):
            tagged = False
            continue
        tagged = part == "attack" and not path
        path.append(str(part))
    return path


def _is_type(part: int | str) -> bool:
    return isinstance(part, str) and (part in _UNION_TAGS or "[" in part)


_UNION_TAGS = {"str", "int", "float", "constrained-str", "constrained-int", "constrained-float"}
