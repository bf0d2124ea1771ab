"""What a task may add to the JSON of a request, of a campaign's grid, of a plan and of a result; and all tasks by name.

Of a request it is `target.ask`, what the network is asked beside showing it the image. Of a grid it is `generate`, the
scenes to make and what is asked about each. Both are validated by the models of the network's task. Of a plan and of a
result it is `tasks[name]`. This module does not import torch, and no task: they register themselves.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Union

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from scene_attack.plugins import Registry
from scene_attack.scenes.description import Scene
from scene_attack.strict import Model, schema_of
from scene_attack.targets.info import TARGETS, TargetInfo

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import RenderableType


class Ask(Model):
    """Base class of what a network may be asked."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """Each thing that is asked, in words."""

    @property
    @abstractmethod
    def name(self) -> str:
        """What lists call the job where something is asked."""

    @classmethod
    @abstractmethod
    def example(cls, target: TargetInfo, scene: Scene) -> Member:
        """What to ask a target to try it, about this scene or one of the task's own."""

    @property
    def goal(self) -> str | None:
        """A sentence about which answers meet the goal; None if it is as the request's `goal` says."""
        return None


@dataclass(frozen=True)
class Member:
    """A scene of a grid, and what a job asks about it."""

    scene: Scene
    ask: Ask | None = None

    def refused(self, tasks: Mapping[str, Any]) -> str | None:
        """Why a network is not to be attacked on it, given what its task adds to the plan; None if it is."""
        del tasks
        return None


class Cases(Model):
    """Base class of the scenes that a grid may have made, each with what is asked about it."""

    @abstractmethod
    def count(self) -> int:
        """The largest number of members that there may be, without making them."""

    @abstractmethod
    def members(self) -> tuple[Member, ...]:
        """All scenes, in order. Raises InvalidRequest, which names a field of the grid."""

    @abstractmethod
    def sample(self) -> Member:
        """The first scene, with one thing asked. Raises InvalidRequest as `members` does."""


class Part(BaseModel):
    """Base class of what a task adds to a plan or to a result, `tasks[name]`."""

    model_config = ConfigDict(extra="forbid")

    def tables(self, folder: Path | None = None) -> Iterable[RenderableType]:
        """What the command line prints of it. folder: that of the job's files, if it is on this machine."""
        del folder
        return ()


class ResultPart(Part):
    """Base class of what a task adds to a result."""

    template: ClassVar[Path | None] = None
    """A Jinja file by which the dashboard's page of a job draws it, with the macros `lead`, `answers` and `sections`;
    each is given what `shown` returns."""

    contents: ClassVar[Mapping[str, str]] = {}
    """Descriptions of the files that the task adds to a job, by name or pattern ("mask-*.png")."""

    @property
    def answers(self) -> list[tuple[str, str]]:
        """The labels before and after of answers that are attacked together; none where there is one answer."""
        return []

    def shown(self, spec: Mapping[str, Any], result: Mapping[str, Any]) -> object:
        """What `template` is given, from the request and the result as JSON data."""
        del spec, result
        return self


@dataclass(frozen=True)
class RegisteredTask:
    """A task: what makes it for a job (`task.MakeTask`), and the models of what it adds; None where it adds nothing."""

    make: Callable[..., Any]
    ask: type[Ask] | None = None
    cases: type[Cases] | None = None
    plan: type[Part] | None = None
    result: type[ResultPart] | None = None


TASKS: Registry[RegisteredTask] = Registry("task", ["scene_attack.runs.own_task"])


def models_of(part: str, target: str | None = None) -> tuple[type[Any], ...]:
    """The models of a part: that of the target's task, none if it has none.

    Of a target or a task that there is not, which is refused elsewhere, any task's may be meant.
    """
    tasks = list(TASKS.values())
    if target is not None and target in TARGETS and TARGETS[target].info.task in TASKS:
        tasks = [TASKS[TARGETS[target].info.task]]
    return tuple(model for task in tasks if (model := getattr(task, part)) is not None)


class _OfTheTarget:
    """Validates a part of a request by the model of the target's task, which an earlier field of the request names."""

    def __init__(self, part: str, target: Callable[[Mapping[str, Any]], str | None], refusal: str) -> None:
        self._part, self._target, self._refusal = part, target, refusal

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        def validate(data: object, info: ValidationInfo) -> Any:
            name = self._target(info.data)
            models = models_of(self._part, name)
            if not models and name in TARGETS:
                raise ValueError(self._refusal.format(name))
            if not models:
                raise ValueError("no installed task has this field; leave it out, or install the plug-in that has it")
            return _one_of(models).validate_python(data, context=info.context)  # its errors become those of the field

        return core_schema.with_info_plain_validator_function(validate)

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return schema_of(models_of(self._part), handler)


class _ByTask:
    """Validates a plan's or a result's `tasks`, each by the model of its task; one that is not installed stays data."""

    def __init__(self, part: str) -> None:
        self._part = part

    def __get_pydantic_core_schema__(self, _source: object, _handler: GetCoreSchemaHandler) -> CoreSchema:
        def validate(data: Any) -> dict[str, Any]:
            return {name: self._read(name, value) for name, value in dict(data).items()}

        return core_schema.no_info_plain_validator_function(validate)

    def _read(self, name: str, value: Any) -> Any:
        model = _model_of(name, self._part)
        return value if model is None else model.model_validate(value)

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        models = {name: getattr(task, self._part) for name, task in TASKS.items()}
        properties = {name: schema_of([model], handler) for name, model in models.items() if model is not None}
        return {"type": "object", "properties": properties} if properties else {"type": "object"}


def _model_of(task: str, part: str) -> Any:
    """The model of a task's part; None if it has none, or is not installed."""
    return getattr(TASKS[task], part) if task in TASKS else None


def _one_of(models: tuple[type[Any], ...]) -> TypeAdapter[Any]:
    return TypeAdapter(Union[models])  # type: ignore[arg-type]  # noqa: UP007


if TYPE_CHECKING:
    AnyAsk = Ask
    AnyCases = Cases
    PlanParts = dict[str, Any]
    ResultParts = dict[str, Any]
else:
    AnyAsk = Annotated[
        Any, _OfTheTarget("ask", lambda data: data.get("name"), "{} is asked nothing beside the image; leave it out")
    ]
    AnyCases = Annotated[
        Any,
        _OfTheTarget(
            "cases",
            lambda data: data["targets"][0].name if "targets" in data else None,
            "{} is shown scenes; give them as `scenes`, or name networks in `targets` that are asked something",
        ),
    ]
    PlanParts = Annotated[dict[str, Any], _ByTask("plan")]
    ResultParts = Annotated[dict[str, Any], _ByTask("result")]


def parts_of(tasks: Mapping[str, Any] | None) -> dict[str, ResultPart]:
    """Those of a result's `tasks` that can be read, as their task is installed, from its JSON data."""
    found = {}
    for name, data in (tasks or {}).items():
        model = _model_of(name, "result")
        with suppress(ValidationError):  # of another version of the plug-in
            if model is not None:
                found[name] = model.model_validate(data)
    return found
