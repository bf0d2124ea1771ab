"""A whole request: the same JSON for `POST /v1/jobs` and `scene-attack run`."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from services.attacks.spec import AttackSpec, Fgsm, Goal, Seed
from services.errors import InvalidRequest
from services.rendering.plan import DEFAULT_TOLERANCE
from services.scenes.description import Model, Scene


class TargetChoice(Model):
    """The network under attack, and the question put to it where it takes one."""

    name: str = Field("efficientnet-lite0", min_length=1, max_length=100)
    question: str | None = Field(None, max_length=1000, description="for targets that answer questions")


class JobSpec(Model):
    """One attack on one scene. Everything but the objects has a default; the stored spec says them all."""

    scene: Scene
    target: TargetChoice = TargetChoice()
    goal: Goal = Goal()
    attack: AttackSpec = Field(default_factory=Fgsm)
    tolerance: Annotated[float, Field(ge=1e-6, le=0.1, allow_inf_nan=False)] | Literal["exact"] = Field(
        DEFAULT_TOLERANCE,
        description="largest error of a displayed value, in [0,1], of pictures inside the attack; `exact` for none; "
        "the verdict is always on the exact picture",
    )
    seed: Seed = Field(0, description="of everything random in the job")

    @model_validator(mode="before")
    @classmethod
    def _default_method(cls, data: Any) -> Any:
        """`method` may be left out: fgsm where the renderer is differentiable, zoo where it is not."""
        if isinstance(data, dict) and isinstance(data.get("attack"), dict) and "method" not in data["attack"]:
            method = "zoo" if data["attack"].get("renderer") == "pyrender" else "fgsm"
            data = data | {"attack": data["attack"] | {"method": method}}
        return data


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
        path = [str(part) for part in item["loc"] if part not in ("body", "fgsm", "zoo") and not _is_type(part)]
        detail = item["msg"].removeprefix("Value error, ")
        if item["type"] == "value_error" and ": " in detail:  # a check over several fields names its own
            name, detail = detail.split(": ", 1)
            path.append(name)
        found.append(InvalidRequest(".".join(path) or "body", detail))
    return found


def _is_type(part: int | str) -> bool:
    return isinstance(part, str) and (part in _UNION_TAGS or "[" in part)


_UNION_TAGS = {"str", "int", "float", "constrained-str", "constrained-int", "constrained-float"}
